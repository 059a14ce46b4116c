"""Which of a device's measurements follow which: damaged ones are dropped, and new starts are found.

A measurement that does not follow the one before is kept aside as a rival. If the next one follows *it*, the device
started anew (or another one sits on the line), and an epoch begins with both. If not, the rival was damaged.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from pretouch_sensor_gateway.epoch import Epoch
from pretouch_sensor_gateway.wire_formats.messages import COUNTER_MODULUS
from pretouch_sensor_gateway.wire_formats.received import Measurement, PingReply

_SLACK = 1.0
"""Seconds that a device may seem to have started too early to have been missed: its period is only estimated."""


@dataclass(frozen=True)
class Arrival:
    """A measurement with the host time at which it was read, and how long it took on the line, s."""

    message: Measurement
    at: float
    transmission: float


@dataclass(frozen=True)
class Successor:
    """A measurement that is believed.

    Attributes:
        begins: whether it is the first of an epoch.
        missing: measurements that nobody heard before it.
        sequence, device: its number, and its time on the device's clock, s, if it tells one.
    """

    arrival: Arrival
    begins: bool
    missing: int
    sequence: int
    device: float | None


class Succession:
    """One device's measurements in their order.

    Attributes:
        last: when the last believed one was read, s.
        implausible: how many were dropped.
    """

    def __init__(self) -> None:
        self.last = -float("inf")
        self.implausible = 0
        self._current: Epoch | None = None
        self._rival: tuple[Epoch, Arrival] | None = None

    @property
    def begun(self) -> bool:
        """Whether an epoch is on."""
        return self._current is not None

    def end(self) -> None:
        """Whatever comes next begins an epoch."""
        self._current = None

    def place(self, arrival: Arrival, tick_modulus: int | None) -> Iterator[Successor]:
        """What is believed now that `arrival` has come: nothing, it, or the rival and it.

        Args:
            tick_modulus: microseconds at which the device's time wraps; None if it tells none.
        """
        message, at = arrival.message, arrival.at
        if self._current is None:
            self.drop_rival()
            yield self._begin(arrival, 0, tick_modulus)
        elif self._current.follows(message, at):
            self.drop_rival()
            yield self._take(arrival, begins=False, unheard=0)
        elif self._rival is not None and self._rival[0].follows(message, at):
            _, first = self._rival
            self._rival = None
            yield self._begin(first, self._unheard(first, message), tick_modulus)
            yield self._take(arrival, begins=False, unheard=0)
        else:
            self.drop_rival()
            epoch = Epoch(tick_modulus, message.boot)
            epoch.take(message, at)
            self._rival = (epoch, arrival)

    def device_time(self, reply: PingReply, at: float) -> float | None:
        """The device's clock, s, in a reply of the present epoch; None if it is of another."""
        if self._current is None or not self._current.follows(reply, at):
            return None
        return self._current.device_time(reply, at)

    def drop_rival(self) -> None:
        """Nothing has confirmed the measurement that was kept aside, if there is one."""
        if self._rival is not None:
            self.implausible += 1
            self._rival = None

    def _begin(self, first: Arrival, unheard: int, tick_modulus: int | None) -> Successor:
        self._current = Epoch(tick_modulus, first.message.boot)
        return self._take(first, begins=True, unheard=unheard)

    def _take(self, arrival: Arrival, begins: bool, unheard: int) -> Successor:
        assert self._current is not None
        sequence, missing, device = self._current.take(arrival.message, arrival.at)
        self.last = arrival.at
        return Successor(arrival, begins, unheard + missing, sequence, device)

    def _unheard(self, first: Arrival, second: Measurement) -> int:
        """How many measurements nobody heard: of its new run, or of the same one if only its clock or count leapt.

        A device that has been running for longer than since the last good one, on another cable, missed nobody.
        """
        assert self._current is not None
        sequence, micros = first.message.sequence, first.message.micros
        if sequence is None or micros is None or second.sequence is None or second.micros is None:
            return 0
        period = (second.micros - micros) % COUNTER_MODULUS * 1e-6 / max(1, second.sequence - sequence)
        count = sequence if first.message.boot != self._current.boot else self._current.missing(sequence)
        return count if count * period <= first.at - self.last + _SLACK else 0
