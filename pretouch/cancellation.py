"""Lets a computation in a thread end early: it asks at natural intervals whether anybody still waits for its result."""

from __future__ import annotations

from contextvars import ContextVar, Token


class Cancelled(Exception):
    """Nobody waits for the result any more."""


class Cancellation:
    """A flag that one thread sets and another, which computes, looks at."""

    def __init__(self) -> None:
        self._cancelled = False

    def cancel(self) -> None:
        """Has the computation end at its next `check`."""
        self._cancelled = True

    def check(self) -> None:
        """Raises `Cancelled` once `cancel` was called."""
        if self._cancelled:
            raise Cancelled


_current: ContextVar[Cancellation] = ContextVar("pretouch_cancellation", default=Cancellation())  # noqa: B039 never set


def current_cancellation() -> Cancellation:
    """The flag of the computation that runs in this context; one that nobody sets if it cannot be cancelled."""
    return _current.get()


def bind_cancellation(cancellation: Cancellation) -> Token[Cancellation]:
    """Makes `cancellation` the present context's."""
    return _current.set(cancellation)


def check_cancelled() -> None:
    """Raises `Cancelled` if nobody waits for the result of the computation that runs in this context."""
    _current.get().check()
