"""Who makes the call that is being served."""

from __future__ import annotations

from contextvars import ContextVar
from dataclasses import dataclass

from pretouch.errors import Forbidden


@dataclass(frozen=True)
class Caller:
    """Who calls, by the token that the call carries.

    Attributes:
        owner: whose sessions the call sees and makes; "" where the service asks for no token or has a single one.
        read_only: the call may change nothing.
    """

    owner: str = ""
    read_only: bool = False


_ANYONE = Caller()
_current: ContextVar[Caller] = ContextVar("pretouch_caller", default=_ANYONE)


def current_caller() -> Caller:
    """The caller of the request or gRPC call that this task serves."""
    return _current.get()


def set_caller(caller: Caller) -> None:
    """Binds the caller to the present task, and to those that it starts."""
    _current.set(caller)


def forbid_change() -> Forbidden:
    """The error for a caller that may only read."""
    return Forbidden("This token may only read.", "Use a token whose role is full.")
