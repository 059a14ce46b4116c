"""`pretouch gateway calibrate` on a real terminal: prompts are read, keys are pressed, Ctrl-C is Ctrl-C."""

from __future__ import annotations

import contextlib
import os
import pty
import re
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.plate_gateway import PlateGateway
from pretouch_sensor_gateway.calibration.file import load
from pretouch_sensor_gateway.calibration.model import ModuleCalibration

PATIENCE = 60.0
CTRL_C, ENTER = b"\x03", b"\r"
PLAIN = ModuleCalibration(0.003, 1.02, 0.0, 0.0007, 0.01)
# the first terminal that the leader of a session opens becomes the one whose Ctrl-C it gets; a shell there would not
# ignore Ctrl-C, though what started this suite may have
PROGRAM = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
terminal = os.open(sys.argv.pop(1), os.O_RDWR)
for descriptor in range(3):
    os.dup2(terminal, descriptor)
from pretouch.cli import main
sys.argv[:1] = ["pretouch", "gateway", "calibrate"]
main()
"""
ANSI = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")


class Terminal:
    """The command on a terminal of its own."""

    def __init__(self, folder: Path, gateway: PlateGateway, *options: str) -> None:
        self._terminal, far_end = pty.openpty()
        self._process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, os.ttyname(far_end), "--gateway", gateway.address, *options],
            cwd=folder,
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            env=os.environ | {"TERM": "xterm", "COLUMNS": "100", "GRPC_VERBOSITY": "ERROR"},
        )
        self._seen = ""
        self._end = time.monotonic() + PATIENCE
        self._far_end = far_end

    def until(self, text: str) -> str:
        """What the screen said up to `text`, which it says now; from here on only what comes later counts."""
        while text not in self._seen:
            if not self._more():
                raise AssertionError(f"the command ended without {text!r}: {self._seen}")
        before, _, self._seen = self._seen.partition(text)
        return before

    def press(self, keys: bytes) -> None:
        os.write(self._terminal, keys)

    def finish(self) -> tuple[int, str]:
        """The exit code, and what the screen still said."""
        while self._more():
            pass
        return self._process.wait(PATIENCE), self._seen

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        for descriptor in (self._terminal, self._far_end):
            with contextlib.suppress(OSError):
                os.close(descriptor)

    def _more(self) -> bool:
        while time.monotonic() < self._end:
            ended = self._process.poll() is not None
            if select.select([self._terminal], [], [], 0.1)[0]:
                text = os.read(self._terminal, 65536).decode(errors="replace")
                self._seen += ANSI.sub("", text).replace("\r\n", "\n")
                return True
            if ended:
                return False
        raise AssertionError(f"the command hangs: {self._seen}")


@pytest.fixture
def gateway() -> Iterator[PlateGateway]:
    with PlateGateway(PLAIN) as gateway:
        yield gateway


def test_a_person_at_a_terminal_calibrates(tmp_path: Path, gateway: PlateGateway) -> None:
    with contextlib.closing(Terminal(tmp_path, gateway, "--warm-up", "600", "--distances", "20,40,80")) as terminal:
        terminal.until("Warming up (Ctrl-C: go on now)")
        terminal.press(CTRL_C)
        terminal.until("The rest of the warm-up is left out.")
        for millimetres in (20, 40, 80):
            terminal.until(f"Put the plate at {millimetres} mm")
            gateway.plate = millimetres / 1000
            terminal.press(ENTER)
            terminal.until(f"{millimetres} mm: the modules read")
        terminal.until("Press Enter to compute")
        terminal.press(ENTER)
        code, told = terminal.finish()
    assert code == 0
    assert "Saved calibration.json" in told
    calibration, record = load(tmp_path / "calibration.json")
    assert calibration.warm_up == 600
    assert record is not None
    assert calibration.modules[0].offset == pytest.approx(0.003, abs=4 * record.modules[0].errors.offset)


@pytest.mark.parametrize(("measured", "code"), [(2, 0), (1, 130)])
def test_ctrl_c_while_it_measures_keeps_what_was_measured(
    tmp_path: Path, gateway: PlateGateway, measured: int, code: int
) -> None:
    with contextlib.closing(Terminal(tmp_path, gateway, "--warm-up", "0")) as terminal:
        for millimetres in (15, 20, 30)[:measured]:
            terminal.until(f"Put the plate at {millimetres} mm")
            gateway.plate = millimetres / 1000
            terminal.press(ENTER)
            terminal.until("the modules read")
        terminal.until("Put the plate at")
        gateway.silent = True
        gateway.streaming.clear()
        terminal.press(ENTER)
        assert gateway.streaming.wait(PATIENCE)
        terminal.press(CTRL_C)
        terminal.until(f"Interrupted: {measured} of 8 distances were measured.")
        ended, told = terminal.finish()
    assert ended == code
    assert "Traceback" not in told
    assert (tmp_path / "calibration.json").exists() == (code == 0)
    if code:
        assert "nothing was saved" in told
