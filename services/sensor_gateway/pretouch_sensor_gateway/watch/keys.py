"""Reads the keys that the user presses."""

from __future__ import annotations

import os
import re
import termios
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from enum import Enum

_KEY = re.compile(rb"\x1b[\[O][0-9;]*[A-Za-z~]|.", re.DOTALL)
_READ = 1024


class Key(Enum):
    """A key with a function; digits are passed as numbers."""

    QUIT = "quit"
    NEXT = "next"
    PREVIOUS = "previous"


_KEYS = {
    b"q": Key.QUIT,
    b"Q": Key.QUIT,
    b"\t": Key.NEXT,
    b"\x1b[C": Key.NEXT,
    b"\x1b[B": Key.NEXT,
    b"\x1bOC": Key.NEXT,
    b"\x1bOB": Key.NEXT,
    b"\x1b[Z": Key.PREVIOUS,  # Shift-Tab
    b"\x1b[D": Key.PREVIOUS,
    b"\x1b[A": Key.PREVIOUS,
    b"\x1bOD": Key.PREVIOUS,
    b"\x1bOA": Key.PREVIOUS,
}


def parse_keys(typed: bytes) -> list[Key | int]:
    """Parses the bytes of a terminal into keys, and digits from 1; other keys are left out."""
    keys: list[Key | int] = []
    for key in _KEY.findall(typed):
        if key in _KEYS:
            keys.append(_KEYS[key])
        elif b"1" <= key <= b"9":
            keys.append(int(key))
    return keys


@contextmanager
def raw_keyboard(descriptor: int) -> Iterator[None]:
    """Makes the terminal pass keys at once and without echo, and only Ctrl-C interrupt; restores it afterwards."""
    before = termios.tcgetattr(descriptor)
    changed = termios.tcgetattr(descriptor)
    changed[3] &= ~(termios.ECHO | termios.ICANON)
    for character in (termios.VSUSP, termios.VQUIT):
        changed[6][character] = b"\x00"
    changed[6][termios.VMIN], changed[6][termios.VTIME] = 1, 0
    termios.tcsetattr(descriptor, termios.TCSADRAIN, changed)
    try:
        yield
    finally:
        with suppress(termios.error):  # the terminal is gone
            termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


def read_typed(descriptor: int) -> bytes:
    """The bytes that wait to be read; none if the terminal is gone."""
    try:
        return os.read(descriptor, _READ)
    except OSError:
        return b""
