"""The offset of a robot's clock from the gateway's, from messages that carry the time at which they were sent."""

from __future__ import annotations

from collections import deque
from math import isfinite, sqrt

MEMORY = 32
"""Exchanges that count: a third of a second of poses at 100 Hz, in which no clock drifts by more than 30 us."""


class ClockOffset:
    """Bounds the robot's clock minus the gateway's, s.

    No message arrives before it was sent. So one from the robot bounds the offset from below and one from the gateway
    from above; the true offset lies between the tightest bounds, which are a round trip apart, less the time that
    either side held the message (Cristian, 1989; the intersection of Marzullo, 1984).
    """

    def __init__(self) -> None:
        self._bounds: deque[tuple[float, float]] = deque(maxlen=MEMORY)

    @property
    def known(self) -> bool:
        """Whether a message went either way."""
        return bool(self._bounds)

    @property
    def value(self) -> float:
        """The middle between the bounds, s."""
        low, high = self._intersect()
        return (low + high) / 2

    @property
    def std(self) -> float:
        """One standard deviation of `value`, s: the true one is anywhere between the bounds."""
        low, high = self._intersect()
        return (high - low) / sqrt(12)

    def add(self, sent: float, robot_received: float, robot_sent: float, received: float) -> bool:
        """Learns from an exchange; bounds that contradict earlier ones replace them: a clock was set.

        Args:
            sent, received: when the gateway sent its message and received the robot's, s by the gateway's clock.
            robot_received, robot_sent: when the robot received that one and sent its own, s by the robot's clock.

        Returns:
            Whether the exchange is possible: the robot held the message for no longer than the exchange took.
        """
        low, high = robot_sent - received, robot_received - sent
        if not (isfinite(low) and isfinite(high) and low <= high):
            return False
        if self._bounds:
            least, most = self._intersect()
            if low > most or high < least:
                self._bounds.clear()
        self._bounds.append((low, high))
        return True

    def _intersect(self) -> tuple[float, float]:
        return max(low for low, _ in self._bounds), min(high for _, high in self._bounds)
