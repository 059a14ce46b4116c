"""Ctrl-C at any time: one line, exit code 130, no traceback. It imports next to nothing, so that it is there first."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

INTERRUPTED = 130
"""Exit code of a command that was interrupted, by Ctrl-C or SIGTERM."""
_LATER = 0.05  # s, in which the callback has returned
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Terminated(KeyboardInterrupt):
    """SIGTERM: as Ctrl-C, but nobody waits for a word."""


def end_at_once_when_interrupted() -> None:
    """For the time in which a program loads: nothing has begun, so there is nothing to end in order."""
    _handle(_end)


@contextmanager
def raising_interrupts() -> Iterator[None]:
    """Within the block an interrupt raises KeyboardInterrupt, so that what was begun is ended in order."""
    before = [signal.getsignal(number) for number in _SIGNALS]
    hook, print_trace = sys.unraisablehook, sys.excepthook

    def raise_again(unraisable: Any) -> None:
        """An interrupt while a callback or destructor ran, where none can be raised, is raised afterwards."""
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            again = threading.Timer(_LATER, signal.pthread_kill, (threading.main_thread().ident, signal.SIGINT))
            again.daemon = True
            again.start()
        else:
            hook(unraisable)

    def print_others(kind: type[BaseException], *rest: Any) -> None:
        """Compiled modules print what they cannot raise, and only then call the other hook."""
        if not issubclass(kind, KeyboardInterrupt):
            print_trace(kind, *rest)

    _handle(_raise)
    sys.unraisablehook, sys.excepthook = raise_again, print_others
    try:
        yield
    finally:
        sys.unraisablehook, sys.excepthook = hook, print_trace
        if threading.current_thread() is threading.main_thread():
            for number, handler in zip(_SIGNALS, before, strict=True):
                signal.signal(number, handler)


@contextmanager
def interrupts_held_back() -> Iterator[None]:
    """Ctrl-C takes effect after the block, so that a child that is started in it is also remembered to be ended.

    Children that are started within never see Ctrl-C.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _handle(handler: Any) -> None:
    """A signal that whoever started this program ignores, as a shell does for background jobs, stays ignored."""
    if threading.current_thread() is threading.main_thread():
        for number in _SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, handler)


def _raise(number: int, _: Any) -> None:
    raise Terminated if number == signal.SIGTERM else KeyboardInterrupt


def _end(number: int, _: Any) -> None:
    if number == signal.SIGINT:
        os.write(2, b"Interrupted.\n")
    os._exit(INTERRUPTED)
