"""What a fleet is to those who use and break it."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import Protocol


class Fault(StrEnum):
    """What can happen to a part."""

    KILL = "kill"
    """SIGKILL of the part's supervisor, and of all that it runs."""
    CRASH = "crash"
    """SIGKILL of the service alone: its supervisor starts it again."""
    HANG = "hang"
    """SIGSTOP of the service alone, for good: its supervisor has to notice."""
    FREEZE = "freeze"
    """SIGSTOP of the whole part, which is continued later."""
    DROP = "drop"
    """The network resets the part's connections and refuses new ones, for a while."""
    BLACKHOLE = "blackhole"
    """The network loses what goes to and from the part, for a while."""


class Fleet(Protocol):
    """A running fleet.

    Attributes:
        rest, grpc: where robots find it.
        parts: names of what can be broken.
    """

    rest: str
    grpc: str
    parts: Sequence[str]

    def faults(self, part: str) -> Sequence[Fault]:
        """What can happen to this part."""
        ...

    def break_part(self, part: str, fault: Fault) -> None:
        """Lets the fault happen."""
        ...

    def mend_part(self, part: str, fault: Fault) -> None:
        """Ends it, where it does not end by itself."""
        ...

    def restarts(self) -> dict[str, int]:
        """How often each part's supervisor said that it started its service again."""
        ...
