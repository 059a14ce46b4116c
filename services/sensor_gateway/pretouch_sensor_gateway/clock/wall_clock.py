"""Converts host times (`time.monotonic`, which never steps) to Unix time, and notices when the Unix clock jumps."""

from __future__ import annotations

JUMP = 0.05
"""Seconds by which the Unix clock must differ from what is expected to count as a jump. A busy host reads its two
clocks milliseconds apart."""
SLEW = 500e-6
"""Seconds a second by which NTP may speed up or slow down the Unix clock without a jump (adjtime, Mills, 2006)."""


class WallClock:
    """Tracks the offset of Unix time from `time.monotonic`. After a jump new times follow the Unix clock.

    Attributes:
        jumps: how often the Unix clock was seen to jump. A host that slept counts too: its monotonic clock stood still.
    """

    def __init__(self) -> None:
        self.jumps = 0
        self._last: tuple[float, float] | None = None

    def observe(self, monotonic: float, unix: float) -> bool:
        """Learns both clocks, s, read at the same moment; returns whether the Unix clock jumped since the last time."""
        offset = unix - monotonic
        jumped = False
        if self._last is not None:
            at, before = self._last
            jumped = abs(offset - before) > JUMP + SLEW * abs(monotonic - at)
        self.jumps += jumped
        self._last = (monotonic, offset)
        return jumped

    def unix(self, monotonic: float) -> float:
        """Unix time, s, at `monotonic`, s.

        Raises:
            RuntimeError: nothing was observed yet, a mistake of the caller.
        """
        if self._last is None:
            raise RuntimeError("The wall clock was asked for a time before it observed one.")
        return monotonic + self._last[1]
