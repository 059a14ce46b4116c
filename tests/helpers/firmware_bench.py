"""The fingertip's firmware on its test bench (`firmware/host`): built once per session, controlled by its console."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import pytest
from pretouch_sensor_gateway.wire_formats.binary import FrameDecoder
from pretouch_sensor_gateway.wire_formats.messages import Message
from pretouch_sensor_gateway.wire_formats.parser import Measurement

FIRMWARE = Path(__file__).parents[2] / "firmware"
MODULES = 6
SANITIZED = "-O1 -g -fsanitize=address,undefined -fno-sanitize-recover=all"


def need(*programs: str) -> None:
    """Skips the test if one of `programs` is not installed."""
    missing = [program for program in programs if shutil.which(program) is None]
    if missing:
        pytest.skip(f"not installed: {', '.join(missing)}")


def make(target: str, build: Path, **variables: str) -> str:
    """What `make target` of the firmware prints, with `build` as its build folder."""
    assignments = [f"{name}={value}" for name, value in {"BUILD": str(build), **variables}.items()]
    done = subprocess.run(
        ["make", "-C", str(FIRMWARE), target, *assignments], capture_output=True, text=True, check=False, timeout=250
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def sanitizers(folder: Path) -> Mapping[str, str]:
    """The variable that makes `make host` build with sanitizers, if this machine's compiler has them."""
    source = folder / "empty.c"
    source.write_text("int main(void) { return 0; }\n")
    probe = ["cc", *SANITIZED.split(), str(source), "-o", str(folder / "empty")]
    works = subprocess.run(probe, capture_output=True, check=False, timeout=60).returncode == 0
    return {"CFLAGS": SANITIZED} if works else {}


class Bench:
    """A bench that runs in a process of its own.

    Attributes:
        frames: decodes all that the board has sent.
        port: the pseudo-terminal's path, None where the console takes the serial line's place.
    """

    def __init__(self, *command: str | Path) -> None:
        self.frames = FrameDecoder()
        self.raw = b""
        self._process = subprocess.Popen(
            [os.fspath(part) for part in command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.port: str | None = None if "--console" in command else self._answer()["port"]

    def _answer(self) -> Any:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, f"the bench ended with {self._process.wait(timeout=30)}"
        return json.loads(line)

    def tell(self, command: str) -> Any:
        """The answer to a command of the console."""
        assert self._process.stdin is not None
        self._process.stdin.write(command + "\n")
        self._process.stdin.flush()
        answer = self._answer()
        assert "error" not in answer, (command, answer)
        return answer

    def run(self, milliseconds: int) -> list[Message]:
        """Lets so much simulated time pass; what the board has sent by then."""
        self.raw = bytes.fromhex(self.tell(f"run {milliseconds}")["sent"])
        return self.frames.feed(self.raw)

    def measurements(self, milliseconds: int) -> list[Measurement]:
        return [message for message in self.run(milliseconds) if isinstance(message, Measurement)]

    def receive(self, data: bytes) -> None:
        """Puts `data` on its way to the board."""
        for at in range(0, len(data), 8192):
            self.tell("receive " + data[at : at + 8192].hex())

    def close(self) -> int:
        """The exit status after the end of standard input."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        status = self._process.wait(timeout=60)
        self._process.stdout.close()
        return status

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        status = self.close()
        if error is None:
            assert status == 0
