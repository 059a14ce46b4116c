"""Unwraps device ticks: microseconds of a counter that wraps become seconds that do not."""

from __future__ import annotations

MAX_JUMP = 5.0
"""Seconds that a message's device time may differ from the one predicted from the last message and the host's clock.
More is a device that restarted; less is a host that was busy. Mistaking a long pause for a restart costs one ping."""


def signed_difference(new: int, old: int, modulus: int = 2**32) -> int:
    """`new` - `old` of two counters that wrap at `modulus`, in [-modulus / 2, modulus / 2)."""
    half = modulus // 2
    return (new - old + half) % modulus - half


class TickUnwrapper:
    """Unwraps the clock of one boot session; how often it wrapped between two messages follows from the host's clock.

    Args:
        modulus: microseconds at which the device's count starts again from 0.
    """

    def __init__(self, modulus: int) -> None:
        self._modulus = modulus
        self._last: tuple[int, float] | None = None

    def follows(self, micros: int, arrival: float) -> bool:
        """Whether `micros`, in a message read at host time `arrival`, s, can be the next time of the same session."""
        if self._last is None:
            return True
        predicted = self._predict(self._last, arrival)
        return abs(signed_difference(micros, predicted, self._modulus)) <= MAX_JUMP * 1e6

    def unwrap(self, micros: int, arrival: float) -> float:
        """Device time, s, of a message's `micros`, which becomes the last one; `arrival` is its host time, s."""
        ticks = micros
        if self._last is not None:
            predicted = self._predict(self._last, arrival)
            ticks = predicted + signed_difference(micros, predicted, self._modulus)
        self._last = (ticks, arrival)
        return ticks * 1e-6

    def restart(self) -> None:
        """Forgets the last time: the device restarted."""
        self._last = None

    @staticmethod
    def _predict(last: tuple[int, float], arrival: float) -> int:
        ticks, at = last
        return ticks + round((arrival - at) * 1e6)
