"""The fingertip's firmware, compiled for its board."""

from __future__ import annotations

import re
from pathlib import Path

from helpers.firmware_bench import make, need

FLASH = 32 * 1024 - 512  # bytes, less the boot loader of an Arduino Uno
RAM = 2 * 1024
STACK = 512  # bytes to be left for it; it was seen to take 188


def test_it_fits_the_board(tmp_path: Path) -> None:
    need("make", "avr-gcc", "avr-size", "avr-objcopy")
    make("avr", tmp_path)
    assert (tmp_path / "avr" / "finger.hex").read_text().endswith(":00000001FF\n")
    taken = {name: int(size) for name, size in re.findall(r"(Program|Data): +(\d+) bytes", make("size", tmp_path))}
    assert 0 < taken["Program"] <= FLASH
    assert 0 < taken["Data"] <= RAM - STACK
