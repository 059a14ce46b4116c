"""One boot of a board, from its start to the next: which messages can belong to it, and what each one adds."""

from __future__ import annotations

from pretouch_sensor_gateway.clock.tick_unwrapper import TickUnwrapper, signed_difference
from pretouch_sensor_gateway.wire_formats.parser import Measurement, PingReply

MAX_RATE = 2000.0
"""Measurements a second that no device exceeds: a sequence that runs faster than its own clock is damaged."""
_FREE_STEPS = 10
"""Measurements that may carry the same time: a device may stamp all measurements of a burst at once."""


class BootSession:
    """Follows a device's boot number, sequence and clock through one boot; a wire format may lack any of the three.

    Args:
        tick_modulus: microseconds at which the device's time wraps; None if it sends none.
        boot: boot number of the session's first measurement.
    """

    def __init__(self, tick_modulus: int | None, boot: int | None) -> None:
        self.boot = boot
        self._modulus = tick_modulus
        self._ticks = None if tick_modulus is None else TickUnwrapper(tick_modulus)
        self._micros: int | None = None
        self._sequence: int | None = None
        self._counted = -1

    def follows(self, message: Measurement | PingReply, at: float) -> bool:
        """Whether `message`, read at host time `at`, s, can belong to this session, after what came before."""
        if message.boot != self.boot:
            return False
        if isinstance(message, PingReply):
            return self._ticks is not None and self._ticks.follows(message.micros, at)
        if message.micros is not None and self._ticks is not None and not self._ticks.follows(message.micros, at):
            return False
        if message.sequence is None or self._sequence is None:
            return True
        step = signed_difference(message.sequence, self._sequence)
        return 1 <= step <= _FREE_STEPS + MAX_RATE * self._measure_elapsed(message.micros)

    def accept(self, measurement: Measurement, at: float) -> tuple[int, int, float | None]:
        """Makes `measurement` the session's newest one.

        Returns:
            Its sequence number (counted here if the device does not), how many measurements are missing before it, and
            its time on the device's clock, s, unwrapped; None if it has none.
        """
        missing = 0
        if measurement.sequence is not None:
            missing = self.count_missing(measurement.sequence)
            self._sequence = measurement.sequence
        self._counted += 1
        sequence = self._counted if measurement.sequence is None else measurement.sequence
        if measurement.micros is None or self._ticks is None:
            return sequence, missing, None
        self._micros = measurement.micros
        return sequence, missing, self._ticks.unwrap(measurement.micros, at)

    def count_missing(self, sequence: int) -> int:
        """How many measurements are missing before the one with this number; 0 before the first."""
        return 0 if self._sequence is None else max(0, signed_difference(sequence, self._sequence) - 1)

    def device_time(self, reply: PingReply, at: float) -> float:
        """The device's clock, s, unwrapped, in a reply that `follows`."""
        assert self._ticks is not None
        return self._ticks.unwrap(reply.micros, at)

    def _measure_elapsed(self, micros: int | None) -> float:
        """Seconds on the device's clock since the last measurement; infinite if the device sends no time."""
        if micros is None or self._micros is None or self._modulus is None:
            return float("inf")
        return (micros - self._micros) % self._modulus * 1e-6
