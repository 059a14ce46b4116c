"""Fingers behind real ptys, in one process: they send frames on time and note when, and answer what they are asked.

What is due goes out at most each millisecond, as over USB. A line that takes no more holds its finger back.
"""

from __future__ import annotations

import os
import select
import time
import tty
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection

import numpy as np
from numpy.typing import NDArray
from pretouch_sensor_gateway.wire_formats.binary import FrameDecoder, encode
from pretouch_sensor_gateway.wire_formats.messages import COUNTER_MODULUS, Identify, Ping
from pretouch_sensor_gateway.wire_formats.parser import Identity, Measurement, PingReply

MODULES = 6
_LEAD, _ENCODING = 0.1, 50e-6
"""Seconds in which a job gets ready, and those that a frame takes to be encoded, at the most."""
_TICK = 1e-3
_HOPELESS = 0.25
"""Seconds behind its time at which a finger gives up."""
_BETWEEN_LOOKS = 100
"""Measurements encoded until the next look at what the fingers are asked."""


@dataclass(frozen=True)
class Job:
    """What to send.

    Attributes:
        fingers: indices of those that send.
        phases: s from `start` to the first frame of each.
        count: frames of each.
        rate: frames a second of each.
        start: ns of the steady clock; `start_of_job` says when is early enough.
        distinct: frames that differ; then they come again, which is good enough for a reader that checks nothing.
    """

    fingers: Sequence[int]
    phases: Sequence[float]
    count: int
    rate: float
    start: int
    distinct: int | None = None


@dataclass(frozen=True)
class Sent:
    """What one finger sent.

    Attributes:
        first: sequence number of the first frame.
        stamps: (n,) ns of the steady clock, before each frame was written; fewer than asked for if it gave up.
        late: s from when the last frame was due until the line had taken all of it.
        held_back: whether the line was ever full.
    """

    first: int
    stamps: NDArray[np.int64]
    late: float
    held_back: bool


def start_of_job(frames: int) -> int:
    """ns of the steady clock: when a job of so many different frames, all fingers together, can begin."""
    return time.monotonic_ns() + round(1e9 * (_LEAD + _ENCODING * frames))


def run(connection: Connection, count: int, seed: int) -> None:
    """The process: tells its ports, then does jobs, and answers each with a `Sent` for each finger that sent."""
    rng = np.random.default_rng(seed)
    fingers = [_Finger(number, rng) for number in range(count)]
    connection.send([finger.port for finger in fingers])
    while True:
        readable, _, _ = select.select([connection.fileno(), *(finger.fileno() for finger in fingers)], [], [])
        if connection.fileno() in readable:
            job: Job | None = connection.recv()
            if job is None:
                return
            connection.send(_do(job, fingers))
        else:
            _answer([finger for finger in fingers if finger.fileno() in readable])


class _Finger:
    """A board of `MODULES` modules whose clock is the host's steady one."""

    def __init__(self, number: int, rng: np.random.Generator) -> None:
        self._master, self._slave = (
            os.openpty()
        )  # both stay open here, so that a reader that ends does not hang up the line
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self.sequence = 0
        self.pending = b""
        self._identity = Identity(int(rng.integers(2**16)), f"{number + 1:016x}", MODULES, 1 / 30, "benchmark 1.0")
        self._ranges = [tuple(row) for row in rng.uniform(0.03, 0.04, (997, MODULES)).tolist()]
        self._decoder = FrameDecoder()

    def fileno(self) -> int:
        return self._master

    def send(self, data: bytes = b"") -> None:
        """Writes what the line takes, in its order; the rest is `pending`."""
        self.pending += data
        with suppress(BlockingIOError):
            self.pending = self.pending[os.write(self._master, self.pending) :]

    def answer(self) -> None:
        """Answers what it was asked."""
        for message in self._decoder.feed(os.read(self._master, 4096)):
            if isinstance(message, Ping):
                self.send(encode(PingReply(self._identity.boot, message.sequence, _micros(time.monotonic_ns()))))
            elif isinstance(message, Identify):
                self.send(encode(self._identity))

    def measure(self, at: float) -> bytes:
        """The next frame, measured at `at`, ns."""
        ranges = self._ranges[self.sequence % len(self._ranges)]
        frame = encode(Measurement(self._identity.boot, self.sequence, _micros(at), ranges, (0,) * MODULES))
        self.sequence = (self.sequence + 1) % COUNTER_MODULUS
        return frame


class _Flow:
    """One finger's part of a job."""

    def __init__(self, job: Job, finger: _Finger, phase: float) -> None:
        self._finger = finger
        self._first = finger.sequence
        self._start = job.start + phase * 1e9
        self._period = 1e9 / job.rate
        self._count = job.count
        self._frames: list[bytes] = []
        self._stamps: list[int] = []
        self._taken_at = 0
        self._held_back = False

    def encode(self, frames: int) -> None:
        """Gets so many more frames ready."""
        first = len(self._frames)
        self._frames += [self._finger.measure(self._start + k * self._period) for k in range(first, first + frames)]

    @property
    def done(self) -> bool:
        return len(self._stamps) == self._count and not self._finger.pending

    @property
    def next_due(self) -> float:
        """ns of the steady clock."""
        return self._start + len(self._stamps) * self._period

    def step(self, now: int) -> None:
        """Writes what is due, and gives up if the line has not taken enough for too long."""
        sent, size = len(self._stamps), len(self._frames)
        due = min(self._count, int((now - self._start) // self._period) + 1)
        if due > sent or self._finger.pending:
            frames = b"".join([self._frames[k % size] for k in range(sent, due)])
            self._stamps += [time.monotonic_ns()] * (due - sent)
            self._finger.send(frames)
            self._taken_at = time.monotonic_ns()
            self._held_back |= bool(self._finger.pending)
        if len(self._finger.pending) * self._period / len(self._frames[0]) > _HOPELESS * 1e9:
            self._count = len(self._stamps)

    def describe(self) -> Sent:
        self._finger.sequence = self._first + len(self._stamps)
        late = (self._taken_at - self.next_due + self._period) * 1e-9
        return Sent(self._first, np.array(self._stamps), late, self._held_back)


def _do(job: Job, fingers: Sequence[_Finger]) -> list[Sent]:
    flows = [_Flow(job, fingers[k], phase) for k, phase in zip(job.fingers, job.phases, strict=True)]
    distinct = job.count if job.distinct is None else min(job.distinct, job.count)
    for begun in range(0, distinct, _BETWEEN_LOOKS):
        for flow in flows:
            flow.encode(min(_BETWEEN_LOOKS, distinct - begun))
            _answer(select.select(fingers, [], [], 0)[0])
    deadline = job.start + (job.count / job.rate + 2 * _HOPELESS + 1) * 1e9
    while not all(flow.done for flow in flows) and (now := time.monotonic_ns()) < deadline:
        for flow in flows:
            flow.step(now)
        due = min((flow.next_due for flow in flows if not flow.done), default=now)
        wait = max(_TICK, (due - time.monotonic_ns()) * 1e-9)
        _answer(select.select(fingers, [], [], wait)[0])
    return [flow.describe() for flow in flows]


def _answer(asked: Sequence[_Finger]) -> None:
    for finger in asked:
        finger.answer()


def _micros(at: float) -> int:
    return int(at) // 1000 % COUNTER_MODULUS
