"""Puts a device's measurements in sequence: drops damaged ones, counts missing ones, and detects that it restarted.

A measurement that does not follow the one before is held back as a candidate. If the next measurement follows the
candidate, the device restarted (or another one is on the port), and a new boot session starts with both. If it does
not, the candidate was damaged and is dropped.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from pretouch_sensor_gateway.boot_session import BootSession
from pretouch_sensor_gateway.wire_formats.messages import COUNTER_MODULUS
from pretouch_sensor_gateway.wire_formats.parser import Measurement, PingReply

_SLACK = 1.0
"""Seconds by which a device may seem to have started too early for its first measurements to be missing: its period is
only estimated."""


@dataclass(frozen=True)
class ReceivedMeasurement:
    """A measurement, the host time at which it was read, and how long it took on the wire, s."""

    measurement: Measurement
    at: float
    transmission: float


@dataclass(frozen=True)
class TrackedMeasurement:
    """A measurement that was accepted.

    Attributes:
        measurement, at, transmission: as in `ReceivedMeasurement`.
        starts_session: whether it is the first of a boot session.
        missing: measurements that were lost before it.
        sequence: its sequence number.
        device_time: its time on the device's clock, s, unwrapped; None if it has none.
    """

    measurement: Measurement
    at: float
    transmission: float
    starts_session: bool
    missing: int
    sequence: int
    device_time: float | None


class SequenceTracker:
    """Tracks the measurements of one device.

    Attributes:
        last_accepted: host time at which the last accepted one was read, s.
        implausible: how many were dropped.
    """

    def __init__(self) -> None:
        self.last_accepted = -float("inf")
        self.implausible = 0
        self._session: BootSession | None = None
        self._candidate: tuple[BootSession, ReceivedMeasurement] | None = None

    @property
    def in_session(self) -> bool:
        """Whether there is a boot session for the next measurement to follow."""
        return self._session is not None

    def end_session(self) -> None:
        """Lets the next measurement start a new boot session, whatever it is."""
        self._session = None

    def track(self, received: ReceivedMeasurement, tick_modulus: int | None) -> Iterator[TrackedMeasurement]:
        """Yields what can be accepted now: nothing, `received`, or the candidate and `received`.

        Args:
            tick_modulus: microseconds at which the device's time wraps; None if it sends none.
        """
        measurement, at = received.measurement, received.at
        if self._session is None:
            self.drop_candidate()
            yield self._start_session(received, 0, tick_modulus)
        elif self._session.follows(measurement, at):
            self.drop_candidate()
            yield self._accept(received, starts_session=False, unheard=0)
        elif self._candidate is not None and self._candidate[0].follows(measurement, at):
            _, first = self._candidate
            self._candidate = None
            yield self._start_session(first, self._count_unheard(first, measurement), tick_modulus)
            yield self._accept(received, starts_session=False, unheard=0)
        else:
            self.drop_candidate()
            session = BootSession(tick_modulus, measurement.boot)
            session.accept(measurement, at)
            self._candidate = (session, received)

    def device_time(self, reply: PingReply, at: float) -> float | None:
        """The device's clock, s, unwrapped, in a reply of the present boot session; None if it is of another."""
        if self._session is None or not self._session.follows(reply, at):
            return None
        return self._session.device_time(reply, at)

    def drop_candidate(self) -> None:
        """Drops the measurement that was held back, if there is one, because nothing confirmed it."""
        if self._candidate is not None:
            self.implausible += 1
            self._candidate = None

    def _start_session(self, first: ReceivedMeasurement, unheard: int, tick_modulus: int | None) -> TrackedMeasurement:
        self._session = BootSession(tick_modulus, first.measurement.boot)
        return self._accept(first, starts_session=True, unheard=unheard)

    def _accept(self, received: ReceivedMeasurement, starts_session: bool, unheard: int) -> TrackedMeasurement:
        assert self._session is not None
        sequence, missing, device_time = self._session.accept(received.measurement, received.at)
        self.last_accepted = received.at
        return TrackedMeasurement(
            received.measurement,
            received.at,
            received.transmission,
            starts_session,
            unheard + missing,
            sequence,
            device_time,
        )

    def _count_unheard(self, first: ReceivedMeasurement, second: Measurement) -> int:
        """How many measurements were lost before `first`: since its boot, or since the last accepted one if only the
        clock or the count of the same boot leapt.

        None if the device has been running for longer than that: it was on another port meanwhile.
        """
        assert self._session is not None
        sequence, micros = first.measurement.sequence, first.measurement.micros
        if sequence is None or micros is None or second.sequence is None or second.micros is None:
            return 0
        period = (second.micros - micros) % COUNTER_MODULUS * 1e-6 / max(1, second.sequence - sequence)
        rebooted = first.measurement.boot != self._session.boot
        count = sequence if rebooted else self._session.count_missing(sequence)
        return count if count * period <= first.at - self.last_accepted + _SLACK else 0
