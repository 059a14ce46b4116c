"""A program in a pseudo-terminal: the screen's contents, and the terminal's state afterwards."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import signal
import struct
import subprocess
import sys
import termios
import threading
from collections.abc import Callable, Sequence
from typing import Any

import pyte

_TIMEOUT = 60.0  # s: a start on a busy machine
_WITH_THIS_TERMINAL = """
import fcntl, os, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.execv(sys.argv[1], sys.argv[1:])
"""
"""Makes standard input the terminal whose Ctrl-C and end are the program's: in the test's own process it would take a
fork, which gRPC's threads do not survive."""


class Terminal:
    """`python -m pretouch` with these arguments in a terminal of 80 columns and 24 lines; a context manager.

    Args:
        variables: of the environment, where PRETOUCH variables are otherwise left out.
    """

    def __init__(self, *arguments: str, variables: dict[str, str] | None = None) -> None:
        self._arguments = arguments
        self._variables = variables or {}
        self._screen = pyte.Screen(80, 24)
        self._stream = pyte.ByteStream(self._screen)
        self._said = bytearray()
        self._changed = threading.Condition()

    def __enter__(self) -> Terminal:
        self._master, self._slave = pty.openpty()
        self._enough = os.pipe()
        self.resize(80, 24)
        self.before = termios.tcgetattr(self._slave)
        kept = {key: value for key, value in os.environ.items() if not key.startswith(("PRETOUCH_", "NO_COLOR"))}
        kept = {key: value for key, value in kept.items() if key not in ("COLUMNS", "LINES")}
        self._process = subprocess.Popen(
            [sys.executable, "-c", _WITH_THIS_TERMINAL, sys.executable, "-m", "pretouch", *self._arguments],
            stdin=self._slave,
            stdout=self._slave,
            stderr=self._slave,
            env=kept | {"TERM": "xterm-256color"} | self._variables,
            start_new_session=True,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        self._close()

    def _close(self) -> None:
        if self._reader.is_alive():
            os.write(self._enough[1], b".")
            self._reader.join(_TIMEOUT)
            for descriptor in (self._slave, self._master, *self._enough):
                os.close(descriptor)

    @property
    def screen(self) -> list[str]:
        """Its lines."""
        return [line.rstrip() for line in self._screen.display]

    @property
    def said(self) -> bytes:
        """All that was written to it."""
        return bytes(self._said)

    @property
    def now(self) -> Sequence[Any]:
        """How the terminal is set, as `before`."""
        return termios.tcgetattr(self._slave)

    def wait_for(self, wanted: str | Callable[[list[str]], bool]) -> list[str]:
        """The screen once `wanted` is on it."""

        def there() -> bool:
            return wanted in "\n".join(self.screen) if isinstance(wanted, str) else wanted(self.screen)

        with self._changed:
            if not self._changed.wait_for(there, _TIMEOUT):
                raise TimeoutError("It did not come to the screen:\n" + "\n".join(self.screen))
            return self.screen

    def type(self, keys: bytes) -> None:
        os.write(self._master, keys)

    def resize(self, columns: int, lines: int) -> None:
        with self._changed:
            self._screen.resize(lines, columns)
            fcntl.ioctl(self._slave, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))

    def tell(self, number: signal.Signals) -> None:
        self._process.send_signal(number)

    def hang_up(self) -> int:
        """Closes the window; its exit code."""
        self._close()
        return self._process.wait(_TIMEOUT)

    def ended(self) -> int:
        """Its exit code, once it has ended and all that it wrote was read."""
        code = self._process.wait(_TIMEOUT)
        mark = b"\x00end\x00"
        os.write(self._slave, mark)
        with self._changed:
            assert self._changed.wait_for(lambda: mark in self._said, _TIMEOUT)
            del self._said[self._said.index(mark) :]
        return code

    def _read(self) -> None:
        while self._enough[0] not in select.select([self._master, self._enough[0]], [], [])[0]:
            data = os.read(self._master, 65536)
            with self._changed:
                self._said += data
                self._stream.feed(data)
                self._changed.notify_all()
