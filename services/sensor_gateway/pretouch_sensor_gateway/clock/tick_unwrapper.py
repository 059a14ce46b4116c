"""Device ticks that wrap become seconds that do not."""

from __future__ import annotations

MAX_JUMP = 5.0
"""Seconds that a message's device time may differ from what the last one and the host's clock foretell. More is a
device that restarted; less is a host that was busy. Mistaking a long pause for a new start costs one ping."""


def signed_difference(new: int, old: int, modulus: int = 2**32) -> int:
    """`new` - `old` of two counters that wrap at `modulus`, in [-modulus / 2, modulus / 2)."""
    half = modulus // 2
    return (new - old + half) % modulus - half


class TickUnwrapper:
    """Microseconds of one run of a device, counted through the wraps; what happened between two is told by the host.

    Args:
        modulus: microseconds at which the device's count starts again from 0.
    """

    def __init__(self, modulus: int) -> None:
        self._modulus = modulus
        self._last: tuple[int, float] | None = None

    def follows(self, micros: int, arrival: float) -> bool:
        """Whether `micros` in a message that came at host time `arrival`, s, can be the next time of the same run."""
        if self._last is None:
            return True
        foretold = self._foretold(self._last, arrival)
        return abs(signed_difference(micros, foretold, self._modulus)) <= MAX_JUMP * 1e6

    def unwrap(self, micros: int, arrival: float) -> float:
        """Device time, s, of a message's `micros`, which is the last from now on; `arrival` is when it came, host s."""
        ticks = micros
        if self._last is not None:
            foretold = self._foretold(self._last, arrival)
            ticks = foretold + signed_difference(micros, foretold, self._modulus)
        self._last = (ticks, arrival)
        return ticks * 1e-6

    def restart(self) -> None:
        """The device restarted: any time may come next."""
        self._last = None

    @staticmethod
    def _foretold(last: tuple[int, float], arrival: float) -> int:
        ticks, at = last
        return ticks + round((arrival - at) * 1e6)
