"""A subscriber of a faulty device that records all that it receives."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from types import TracebackType
from typing import Any, Self

import numpy as np
from grpc.aio import AioRpcError
from pretouch_sensor_gateway.wire_formats.messages import COUNTER_MODULUS

from helpers.faulty_board import metres
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import array_from_proto

_RANGE_STEP = 0.51e-4  # m: half a step on the wire, and a little
_LATE = 0.002
"""Seconds that a time may be off beyond what its standard deviation allows: the test's own two clock readings."""


@dataclass
class Account:
    """The frames and the reported gaps that a subscriber received, with their arrival times, s of `time.monotonic`."""

    got: int = 0
    lost: int = 0
    overrun: int = 0
    answers: list[pb.StreamRangesResponse] = field(default_factory=list)
    came: list[float] = field(default_factory=list)

    def note(self, answer: pb.StreamRangesResponse) -> None:
        self.answers.append(answer)
        self.came.append(time.monotonic())
        self.got += answer.batch.t.shape[0]
        self.lost += answer.batch.lost
        self.overrun += answer.overrun

    @property
    def told(self) -> int:
        """The number of measurements that were received or reported as lost."""
        return self.got + self.lost + self.overrun

    @property
    def batches(self) -> list[pb.RangeBatch]:
        return [answer.batch for answer in self.answers]

    def epochs(self) -> list[int]:
        """Each epoch once, in the order in which they came."""
        return list(dict.fromkeys(batch.epoch for batch in self.batches))

    def sequence(self, epoch: int = 0) -> list[int]:
        """The sequence numbers of all frames of that epoch."""
        return [
            int(number)
            for batch in self.batches
            if batch.epoch == epoch
            for number in array_from_proto(batch.sequence, "sequence")
        ]

    def times(self, epoch: int = 0) -> dict[int, float]:
        """When each frame of that epoch was, s since the Unix epoch, by its sequence number."""
        return {
            int(number): float(t)
            for batch in self.batches
            if batch.epoch == epoch
            for number, t in zip(
                array_from_proto(batch.sequence, "sequence"), array_from_proto(batch.t, "t"), strict=True
            )
        }

    def check_frames(self, boots: Mapping[int, int], times: Mapping[tuple[int, int], float], offset: float) -> None:
        """Checks that each frame is one of the board's, of the right boot, with its range and its time.

        Args:
            boots: the boot number behind each epoch.
            times: when each was measured, s of `time.monotonic`, by boot number and sequence.
            offset: from there to the Unix epoch, s.
        """
        for batch in self.batches:
            boot = boots[batch.epoch]
            for number, t, raw in zip(
                array_from_proto(batch.sequence, "sequence").tolist(),
                array_from_proto(batch.t, "t").tolist(),
                array_from_proto(batch.raw, "raw"),
                strict=True,
            ):
                assert abs(t - (times[boot, number] + offset)) <= 4 * batch.time_std + _LATE
                expected = [metres(boot, number, k) for k in range(len(raw))]
                np.testing.assert_allclose(raw, expected, atol=_RANGE_STEP, rtol=0)

    def check_gaps(self) -> None:
        """Checks that numbers increase, and that a gap between two frames was reported before the second one."""
        for before, after in pairwise(self.answers):
            if before.batch.epoch != after.batch.epoch:
                continue
            last = int(array_from_proto(before.batch.sequence, "sequence")[-1])
            sequence = array_from_proto(after.batch.sequence, "sequence").astype(np.int64)
            steps = np.diff(sequence, prepend=last) % COUNTER_MODULUS
            assert ((steps > 0) & (steps < COUNTER_MODULUS // 2)).all()
            assert steps.sum() == len(sequence) + after.batch.lost + after.overrun


class Listener(Account):
    """Reads a stream in the background, while `reads` is set.

    Attributes:
        end: why the stream ended, None while it has not.
    """

    def __init__(self, stream: Any) -> None:
        super().__init__()
        self.end: AioRpcError | None = None
        self.reads = asyncio.Event()
        self.reads.set()
        self._stream = stream
        self._news = asyncio.Event()
        self._reading: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        self._reading = asyncio.create_task(self._read())
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._reading is not None
        self._reading.cancel()  # and with it the call, if it waits for an answer
        await asyncio.gather(self._reading, return_exceptions=True)
        self._stream.cancel()

    async def until(self, come: Callable[[], bool]) -> None:
        """Waits until the condition holds.

        Raises:
            AioRpcError: the stream ended first.
        """
        while not come():
            if self.end is not None:
                raise self.end
            await self._news.wait()
            self._news.clear()

    async def ended(self) -> AioRpcError:
        """Waits for the end of the stream; returns why it ended."""
        while self.end is None:
            await self._news.wait()
            self._news.clear()
        return self.end

    async def _read(self) -> None:
        try:
            while True:
                await self.reads.wait()
                self.note(await self._stream.read())
                self._news.set()
        except AioRpcError as error:
            self.end = error
            self._news.set()
