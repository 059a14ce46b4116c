"""From a device's bytes to timestamped batches: everything that happens to one device's data, without any I/O.

bytes ─▶ parser ─▶ sequence tracker ─▶ clock sync ─▶ batch builder ─▶ batch
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from itertools import groupby

from pretouch_sensor_gateway.batch_builder import BatchBuilder
from pretouch_sensor_gateway.calibration.model import Calibration
from pretouch_sensor_gateway.clock_sync import ClockSync
from pretouch_sensor_gateway.handshake import Handshake
from pretouch_sensor_gateway.range_batch import RangeBatch
from pretouch_sensor_gateway.sequence_tracker import ReceivedMeasurement, SequenceTracker, TrackedMeasurement
from pretouch_sensor_gateway.source import ClockState
from pretouch_sensor_gateway.wire_formats.binary import END, encode
from pretouch_sensor_gateway.wire_formats.parser import (
    DeviceMessage,
    Identity,
    Measurement,
    Parser,
    PingReply,
    Refusal,
)

CONFIRM_WITHIN = 0.5
"""Seconds after a port was reopened for which measurements are held until it is known which board is on it."""
MAX_HELD = 256
"""Measurements held until the device's clock is known; it takes milliseconds, so more means that it never will be."""


class MeasurementPipeline:
    """Processes one device's bytes in their order. Host times are seconds of `time.monotonic`, given by the caller.

    Args:
        parser: of the device's wire format.
        byte_time: s that a byte takes on the wire; 0 where that is not known.
        calibration: of its modules, and perhaps of one board only.
        latency: s from a measurement to the time in its frame, or to the begin of its line; None: not known.

    Attributes:
        measurements: given in batches so far. Any other good one is still held, or counted as untimed or refused.
        lost: measurements missing by sequence so far.
        untimed: good measurements given up because the device's clock was not known.
        epoch: number of the boot session: how often the device was seen to restart.
    """

    def __init__(
        self, parser: Parser, byte_time: float, calibration: Calibration | None, latency: float | None = None
    ) -> None:
        self.measurements = self.lost = self.untimed = self.epoch = 0
        self._refused: Counter[Refusal] = Counter()
        self._parser = parser
        self._byte_time = byte_time
        self._batch_builder = BatchBuilder(calibration)
        self._handshake = Handshake()
        self._clock_sync = ClockSync(latency)
        self._tracker = SequenceTracker()
        self._last_format = parser.name
        self._session_start = 0.0
        self._held: deque[TrackedMeasurement] = deque()  # until they can be timestamped
        self._finished: list[RangeBatch] = []  # of a boot session that ended within the bytes being fed
        self._board: str | None = None  # serial number of the boot session's board, once it is known
        self._unconfirmed_since: float | None = None  # when the port was reopened, until the board is confirmed
        self._unconfirmed: list[ReceivedMeasurement] = []
        self._unreported = 0  # lost, and not yet reported in a batch
        self._uncalibrated_modules = 0  # of the last measurement, if the calibration has another number of modules

    @property
    def refused(self) -> Counter[Refusal]:
        """Frames or lines refused so far, by reason."""
        implausible = Counter({Refusal.IMPLAUSIBLE: self._tracker.implausible})
        return self._parser.refused + self._refused + implausible

    @property
    def last_accepted(self) -> float:
        """When the last good measurement was read, s."""
        return self._tracker.last_accepted

    @property
    def format_name(self) -> str:
        return self._parser.name

    @property
    def identity(self) -> Identity | None:
        """What the device reported of itself; None if nothing yet."""
        return self._handshake.identity

    @property
    def synchronised(self) -> bool:
        """Whether measurements can be timestamped."""
        if self._parser.two_way:
            return self._clock_sync.ping_answered
        return self._parser.name != "" and self._tracker.in_session

    @property
    def clock(self) -> ClockState:
        return self._clock_sync.state(self.synchronised)

    @property
    def next_send(self) -> float:
        """When `take_outgoing` has something to send, s."""
        return self._handshake.next_send if self._parser.two_way else float("inf")

    def take_outgoing(self, at: float) -> bytes:
        """The bytes to send to the device now."""
        if at < self.next_send:
            return b""
        frames = [encode(message) for message in self._handshake.take_due(at)]
        return END + b"".join(frames)  # the END first: a port may have taken only a part of what was sent before

    def calibrate(self, calibration: Calibration | None) -> None:
        """Calibrates ranges by `calibration` from now on."""
        self._batch_builder.calibrate(calibration)

    def on_port_opened(self, at: float) -> None:
        """The port is open: the handshake starts over, and a half-received message is void."""
        self._parser.restart()
        self._handshake.start(at)
        self._unconfirmed_since = at if self._tracker.in_session else None

    def on_port_closed(self) -> None:
        """The port is closed: whatever waits for confirmation will get none."""
        self._release_unconfirmed()
        self._tracker.drop_candidate()

    def feed(self, data: bytes, at: float, unix: float) -> list[RangeBatch]:
        """The batches that `data` completes, read at host time `at`, s, which was Unix time `unix`, s."""
        self._clock_sync.observe_host(at, unix)
        messages = self._parse(data)
        for message, transmission in zip(messages, self._measure_transmissions(messages), strict=True):
            match message:
                case Measurement() if self._needs_confirmation(at):
                    self._unconfirmed.append(ReceivedMeasurement(message, at, transmission))
                case Measurement():
                    self._release_unconfirmed()
                    self._track(ReceivedMeasurement(message, at, transmission))
                case PingReply():
                    self._release_unconfirmed()
                    self._add_ping(message, at)
                case Identity():
                    self._identify(message)
                    self._release_unconfirmed()
        finished, self._finished = [*self._finished, *self._build_batches(at)], []
        return finished

    def problem(self) -> str:
        """Why good measurements are not passed on; "" if they are."""
        if self._is_foreign():
            board = self.identity.serial if self.identity else ""
            return f"Board {board or 'without a serial'} is connected; the calibration is of {self._wanted_serial}."
        if self._uncalibrated_modules:
            return f"The device has {self._uncalibrated_modules} modules, and its calibration describes another number."
        if self._parser.two_way and self._wanted_serial and self.identity is None:
            return "The device does not say which board it is, and its calibration is of one board only."
        if not self.synchronised:
            return "The device answers no pings, so its frames have no time and are not passed on."
        return ""

    def _parse(self, data: bytes) -> list[DeviceMessage]:
        """The messages in `data`. A device that turns out to speak another format than before is another device."""
        format_before = self._parser.name
        messages = self._parser.feed(data)
        if self._parser.name == format_before:
            return messages
        if self._parser.name != self._last_format:
            self._end_session()
        self._last_format = self._parser.name
        if self._parser.two_way:
            return messages
        # The lines by which the format was recognised come out together: only of the last is the arrival time known.
        early = max(0, len(messages) - 1)
        self.untimed += early
        self._unreported += early
        return messages[early:]

    def _measure_transmissions(self, messages: Sequence[DeviceMessage]) -> list[float]:
        """Seconds from the first byte of each message to the last byte of the last, all completed by one read."""
        sizes = [message.size if isinstance(message, Measurement) else 0 for message in messages]
        return [sum(sizes[k:]) * self._byte_time for k in range(len(sizes))]

    def _needs_confirmation(self, at: float) -> bool:
        """Whether this may be another board than before, whose boot number, sequence and clock happen to fit."""
        since = self._unconfirmed_since
        return since is not None and self._parser.two_way and at - since < CONFIRM_WITHIN

    def _release_unconfirmed(self) -> None:
        """Tracks what was held back: which board is on the port is known now, or never will be."""
        self._unconfirmed_since = None
        unconfirmed, self._unconfirmed = self._unconfirmed, []
        for received in unconfirmed:
            self._track(received)

    def _identify(self, identity: Identity) -> None:
        if self._board not in (None, identity.serial):
            self._end_session()
        self._board = identity.serial
        self._handshake.identity = identity

    def _end_session(self) -> None:
        """Ends the boot session: another device is on the port, and what it measures follows nothing."""
        if self._tracker.in_session:
            self.epoch += 1
            self._tracker.end_session()

    def _track(self, received: ReceivedMeasurement) -> None:
        was_in_session = self._tracker.in_session
        for tracked in self._tracker.track(received, self._parser.tick_modulus):
            if tracked.starts_session:
                self._start_session(tracked.at, was_in_session)
            self._hold(tracked)

    def _start_session(self, at: float, was_in_session: bool) -> None:
        """Starts a boot session whose first measurement was read at `at`.

        If another one was on until now, the measurements held of it are timestamped now, or never.
        """
        if was_in_session:
            self._finished += self._build_batches(at)
            self.epoch += 1
        self.untimed += len(self._held)
        self._unreported += len(self._held)
        self._held.clear()
        self._session_start = at
        self._board = None
        self._clock_sync.restart()
        self._batch_builder.restart()
        self._handshake.start(at)

    def _hold(self, tracked: TrackedMeasurement) -> None:
        self.lost += tracked.missing
        self._unreported += tracked.missing
        if len(self._held) == MAX_HELD and not self._can_pass_on:
            self._held.popleft()
            self.untimed += 1
            self._unreported += 1
        self._held.append(tracked)

    def _add_ping(self, reply: PingReply, at: float) -> None:
        device_time = self._tracker.device_time(reply, at)
        sent = None if device_time is None else self._handshake.pop_sent(reply.sequence)
        if sent is not None and device_time is not None:
            self._clock_sync.add_ping(sent, at, device_time)

    def _build_batches(self, at: float) -> Iterator[RangeBatch]:
        """Batches of everything held, if it can be timestamped by now."""
        if not self._can_pass_on:
            return
        held, self._held = list(self._held), deque()
        if self._is_foreign():
            self._refused[Refusal.FOREIGN] += len(held)
            return
        for modules, group in groupby(held, lambda tracked: len(tracked.measurement.ranges)):
            tracked = list(group)
            if not self._batch_builder.accepts(modules):
                self._refused[Refusal.FOREIGN] += len(tracked)
                self._uncalibrated_modules = modules
                continue
            times = [self._clock_sync.timestamp(one, self._parser.two_way) for one in tracked]
            age = at - self._session_start
            batch = self._batch_builder.build(tracked, times, self.epoch, age, self._unreported, self._parser.name)
            self._unreported = self._uncalibrated_modules = 0
            self.measurements += len(batch)
            yield batch

    @property
    def _can_pass_on(self) -> bool:
        """Whether measurements can be timestamped, and it is known that they are of the right board, if it matters."""
        return self.synchronised and not (self._parser.two_way and self._wanted_serial and self.identity is None)

    @property
    def _wanted_serial(self) -> str:
        calibration = self._batch_builder.calibration
        return "" if calibration is None else calibration.serial

    def _is_foreign(self) -> bool:
        """Whether another board than the calibrated one is connected."""
        return bool(self._wanted_serial) and self.identity is not None and self.identity.serial != self._wanted_serial
