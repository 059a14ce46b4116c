"""One run of a device, from its start to the next: what can follow what within it."""

from __future__ import annotations

from pretouch_sensor_gateway.clock.ticks import TickCounter, signed_difference
from pretouch_sensor_gateway.wire_formats.received import Measurement, PingReply

MAX_RATE = 2000.0
"""Measurements a second that no device exceeds: a sequence that runs faster than its own clock is damaged."""
_FREE_STEPS = 10
"""Measurements whose times may be the same: a device may stamp those of a burst together."""


class Epoch:
    """Follows the boot number, sequence and clock of a device; a format may lack any of them.

    Args:
        tick_modulus: microseconds at which the device's time wraps; None if it tells none.
        boot: of the measurement that begins the epoch.
    """

    def __init__(self, tick_modulus: int | None, boot: int | None) -> None:
        self.boot = boot
        self._modulus = tick_modulus
        self._ticks = None if tick_modulus is None else TickCounter(tick_modulus)
        self._micros: int | None = None
        self._sequence: int | None = None
        self._counted = -1

    def follows(self, message: Measurement | PingReply, at: float) -> bool:
        """Whether `message`, heard at host time `at`, s, can be of this epoch, after what came before."""
        if message.boot != self.boot:
            return False
        if isinstance(message, PingReply):
            return self._ticks is not None and self._ticks.follows(message.micros, at)
        if message.micros is not None and self._ticks is not None and not self._ticks.follows(message.micros, at):
            return False
        if message.sequence is None or self._sequence is None:
            return True
        step = signed_difference(message.sequence, self._sequence)
        return 1 <= step <= _FREE_STEPS + MAX_RATE * self._elapsed(message.micros)

    def take(self, message: Measurement, at: float) -> tuple[int, int, float | None]:
        """Goes on to `message`.

        Returns:
            Its sequence (counted here if the device does not), how many are missing before it, and its time on the
            device's clock, s, without wraps; None if it tells none.
        """
        missing = 0
        if message.sequence is not None:
            missing = self.missing(message.sequence)
            self._sequence = message.sequence
        self._counted += 1
        sequence = self._counted if message.sequence is None else message.sequence
        if message.micros is None or self._ticks is None:
            return sequence, missing, None
        self._micros = message.micros
        return sequence, missing, self._ticks.unwrap(message.micros, at)

    def missing(self, sequence: int) -> int:
        """How many measurements are missing before that one; 0 before the first."""
        return 0 if self._sequence is None else max(0, signed_difference(sequence, self._sequence) - 1)

    def device_time(self, reply: PingReply, at: float) -> float:
        """The device's clock, s, without wraps, in a reply that `follows`."""
        assert self._ticks is not None
        return self._ticks.unwrap(reply.micros, at)

    def _elapsed(self, micros: int | None) -> float:
        """Seconds of the device's clock since the last measurement; infinite if it tells none."""
        if micros is None or self._micros is None or self._modulus is None:
            return float("inf")
        return (micros - self._micros) % self._modulus * 1e-6
