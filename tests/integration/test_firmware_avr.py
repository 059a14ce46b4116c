"""The fingertip's firmware, compiled for its board."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from helpers.firmware_bench import make, need

FLASH, RAM = 5100, 466
"""Bytes: a sixth of the flash and a quarter of the RAM of the smallest board, whose stack was seen to take 188."""


@pytest.mark.parametrize("mcu", ["atmega328p", "atmega2560", "atmega32u4"])
def test_it_fits_the_board(mcu: str, tmp_path: Path) -> None:
    need("make", "avr-gcc", "avr-size", "avr-objcopy")
    make("avr", tmp_path, MCU=mcu)
    assert (tmp_path / mcu / "finger.hex").read_text().endswith(":00000001FF\n")
    sizes = re.findall(r"(Program|Data): +(\d+) bytes", make("size", tmp_path, MCU=mcu))
    taken = {name: int(size) for name, size in sizes}
    assert 0 < taken["Program"] <= FLASH
    assert 0 < taken["Data"] <= RAM
