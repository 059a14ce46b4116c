"""What a person types while the view is on the screen."""

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
    """A key with a meaning; a digit stands for itself."""

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


def keys_in(typed: bytes) -> list[Key | int]:
    """The keys and digits from 1 in what a terminal sent; what means nothing is left out."""
    keys: list[Key | int] = []
    for key in _KEY.findall(typed):
        if key in _KEYS:
            keys.append(_KEYS[key])
        elif b"1" <= key <= b"9":
            keys.append(int(key))
    return keys


@contextmanager
def typing(descriptor: int) -> Iterator[None]:
    """Lets the terminal hand over keys at once and unseen, and no key but Ctrl-C stop the program; then as before."""
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


def typed(descriptor: int) -> bytes:
    """What waits to be read; nothing if the terminal is gone."""
    try:
        return os.read(descriptor, _READ)
    except OSError:
        return b""
