"""From a device's bytes to batches with times: the whole way of one device, without any I/O.

bytes ─▶ wire format ─▶ succession ─▶ timing ─▶ assembler ─▶ batch
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from itertools import groupby

from pretouch_sensor_gateway.assembler import Assembler
from pretouch_sensor_gateway.batch import Batch
from pretouch_sensor_gateway.calibration.model import Calibration
from pretouch_sensor_gateway.handshake import Handshake
from pretouch_sensor_gateway.source import ClockState
from pretouch_sensor_gateway.succession import Arrival, Succession, Successor
from pretouch_sensor_gateway.timing import Timing
from pretouch_sensor_gateway.wire_formats.binary import END, encode
from pretouch_sensor_gateway.wire_formats.received import (
    Identity,
    Measurement,
    PingReply,
    Received,
    Refusal,
    WireFormat,
)

CONFIRM_WITHIN = 0.5
"""Seconds for which a line that was opened again may leave open whether the same board is on it."""
MAX_HELD = 256
"""Measurements held until the device's clock is known; it takes milliseconds, so more means that it never will be."""


class Intake:
    """One device's bytes in their order. Host times are seconds of `time.monotonic`, which the caller tells.

    Args:
        wire_format: how the device speaks.
        byte_time: s that a byte takes on the line; 0 where that is not known.
        calibration: of its modules, and perhaps of one board only.

    Attributes:
        frames: measurements given in batches so far. Another good one is held, `untimed`, or refused as foreign.
        lost: measurements missing by sequence so far.
        untimed: good measurements given up because the device's clock was not known.
        epoch: how often the device was seen to start anew.
    """

    def __init__(self, wire_format: WireFormat, byte_time: float, calibration: Calibration | None) -> None:
        self.frames = self.lost = self.untimed = self.epoch = 0
        self._refused: Counter[Refusal] = Counter()
        self._format = wire_format
        self._byte_time = byte_time
        self._assembler = Assembler(calibration)
        self._handshake = Handshake()
        self._timing = Timing()
        self._succession = Succession()
        self._spoken = wire_format.name
        self._began = 0.0
        self._held: deque[Successor] = deque()
        self._given: list[Batch] = []  # of an epoch that ended amid what was received
        self._board: str | None = None  # serial of the epoch's board, once it is known
        self._unconfirmed_since: float | None = None  # the line was opened again, and nothing was answered since
        self._waiting: list[Arrival] = []
        self._untold = 0  # lost, and not yet told in a batch
        self._undescribed = 0  # modules of the last measurement, if the calibration is of another number

    @property
    def refused(self) -> Counter[Refusal]:
        """Frames or lines refused so far, by reason."""
        implausible = Counter({Refusal.IMPLAUSIBLE: self._succession.implausible})
        return self._format.refused + self._refused + implausible

    @property
    def last_good(self) -> float:
        """When the last good measurement came, s."""
        return self._succession.last

    @property
    def format_name(self) -> str:
        return self._format.name

    @property
    def identity(self) -> Identity | None:
        """What the device says of itself; None while it has not."""
        return self._handshake.identity

    @property
    def synchronised(self) -> bool:
        """Whether measurements can be given a time."""
        if self._format.two_way:
            return self._timing.answers
        return self._format.name != "" and self._succession.begun

    @property
    def clock(self) -> ClockState:
        return self._timing.state(self.synchronised)

    @property
    def next_send(self) -> float:
        """When `outgoing` has something to send, s."""
        return self._handshake.next if self._format.two_way else float("inf")

    def outgoing(self, at: float) -> bytes:
        """What is to be sent to the device now."""
        if at < self.next_send:
            return b""
        frames = [encode(message) for message in self._handshake.due(at)]
        return END + b"".join(frames)  # the END first: a port may have taken only a part of what was sent before

    def calibrate(self, calibration: Calibration | None) -> None:
        """Takes ranges by `calibration` from now on."""
        self._assembler.calibration = calibration

    def opened(self, at: float) -> None:
        """The line is open: the whole handshake begins again, and what was half received is void."""
        self._format.restart()
        self._handshake.begin(at)
        self._unconfirmed_since = at if self._succession.begun else None

    def closed(self) -> None:
        """The line is cut: what waits for confirmation will get none."""
        self._confirmed()
        self._succession.drop_rival()

    def received(self, data: bytes, at: float, unix: float) -> list[Batch]:
        """Bytes of the device, read at host time `at`, s, which was `unix` s since the Unix epoch."""
        self._timing.observe(at, unix)
        transmission = len(data) * self._byte_time
        for message in self._heard(data):
            match message:
                case Measurement() if self._to_be_confirmed(at):
                    self._waiting.append(Arrival(message, at, transmission))
                case Measurement():
                    self._confirmed()
                    self._measured(Arrival(message, at, transmission))
                case PingReply():
                    self._confirmed()
                    self._answered(message, at)
                case Identity():
                    self._identified(message)
                    self._confirmed()
        given, self._given = [*self._given, *self._batches(at)], []
        return given

    def problem(self) -> str:
        """Why good measurements are not passed on; "" if they are."""
        if self._foreign():
            board = self.identity.serial if self.identity else ""
            return f"Board {board or 'without a serial'} is connected; the calibration is of {self._wanted_serial}."
        if self._undescribed:
            return f"The device has {self._undescribed} modules, and its calibration describes another number."
        if self._format.two_way and self._wanted_serial and self.identity is None:
            return "The device does not say which board it is, and its calibration is of one board only."
        if not self.synchronised:
            return "The device answers no pings, so its frames have no time and are not passed on."
        return ""

    def _heard(self, data: bytes) -> list[Received]:
        """What the device says. One that turns out to speak another format than before begins an epoch of its own."""
        recognised = self._format.name
        messages = self._format.feed(data)
        if self._format.name == recognised:
            return messages
        if self._format.name != self._spoken:
            self._end_epoch()
        self._spoken = self._format.name
        if self._format.two_way:
            return messages
        # The lines that it was recognised by come at once, and nothing tells when all but the last one arrived.
        early = max(0, len(messages) - 1)
        self.untimed += early
        self._untold += early
        return messages[early:]

    def _to_be_confirmed(self, at: float) -> bool:
        """Whether another board may be on the line than before, whose boot number, sequence and clock happen to fit."""
        since = self._unconfirmed_since
        return since is not None and self._format.two_way and at - since < CONFIRM_WITHIN

    def _confirmed(self) -> None:
        """Who is on the line is known now, or will never be."""
        self._unconfirmed_since = None
        waiting, self._waiting = self._waiting, []
        for arrival in waiting:
            self._measured(arrival)

    def _identified(self, identity: Identity) -> None:
        if self._board not in (None, identity.serial):
            self._end_epoch()
        self._board = identity.serial
        self._handshake.identity = identity

    def _end_epoch(self) -> None:
        """Another device is on the line: what it measures does not follow what came before."""
        if self._succession.begun:
            self.epoch += 1
            self._succession.end()

    def _measured(self, arrival: Arrival) -> None:
        continued = self._succession.begun
        for successor in self._succession.place(arrival, self._format.tick_modulus):
            if successor.begins:
                self._begin(successor.arrival.at, continued)
            self._take(successor)

    def _begin(self, at: float, continued: bool) -> None:
        """A new epoch, first heard at `at`; `continued`: the one before was not ended before this was known.

        What is held of the one before gets its time now, or never.
        """
        if continued:
            self._given += self._batches(at)
            self.epoch += 1
        self.untimed += len(self._held)
        self._untold += len(self._held)
        self._held.clear()
        self._began = at
        self._board = None
        self._timing.restart()
        self._assembler.restart()
        self._handshake.begin(at)

    def _take(self, successor: Successor) -> None:
        self.lost += successor.missing
        self._untold += successor.missing
        if len(self._held) == MAX_HELD and not self._passes:
            self._held.popleft()
            self.untimed += 1
            self._untold += 1
        self._held.append(successor)

    def _answered(self, reply: PingReply, at: float) -> None:
        device = self._succession.device_time(reply, at)
        sent = None if device is None else self._handshake.sent(reply.sequence)
        if sent is not None and device is not None:
            self._timing.answered(sent, at, device)

    def _batches(self, at: float) -> Iterator[Batch]:
        """What can be given a time by now, as batches."""
        if not self._passes:
            return
        held, self._held = list(self._held), deque()
        if self._foreign():
            self._refused[Refusal.FOREIGN] += len(held)
            return
        for count, group in groupby(held, lambda held: len(held.arrival.message.ranges)):
            successors = list(group)
            if not self._assembler.describes(count):
                self._refused[Refusal.FOREIGN] += len(successors)
                self._undescribed = count
                continue
            timed = [self._timing.timed(one, self._format.two_way) for one in successors]
            batch = self._assembler.batch(timed, self.epoch, at - self._began, self._untold)
            self._untold = self._undescribed = 0
            self.frames += len(batch)
            yield batch

    @property
    def _passes(self) -> bool:
        """Whether measurements can be given a time, and are of a board that may be told."""
        return self.synchronised and not (self._format.two_way and self._wanted_serial and self.identity is None)

    @property
    def _wanted_serial(self) -> str:
        calibration = self._assembler.calibration
        return "" if calibration is None else calibration.serial

    def _foreign(self) -> bool:
        """Whether another board answers than the one that was calibrated."""
        return bool(self._wanted_serial) and self.identity is not None and self.identity.serial != self._wanted_serial
