"""Plays a recording as if it were the device."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from enum import Enum
from itertools import islice
from pathlib import Path

from google.protobuf.message import DecodeError

from pretouch.errors import InvalidInput
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch_sensor_gateway.recording.reader import Recorded, RecordingReader
from pretouch_sensor_gateway.recording.validation import CONFIGURATION, RANGES, check_ranges

LONGEST_GAP = 10.0
"""Longest pause between two batches, s: longer gaps in the recording are shortened to this."""
_READ_AHEAD = 256


class Pace(Enum):
    """The pace at which a recording is played."""

    AS_RECORDED = "the time between two batches is that between their last frames"
    AT_ONCE = "as fast as it can be read"


class PlaybackState(Enum):
    """The state of a playback."""

    WAITING = "not begun"
    PLAYING = "batches come"
    ENDED = "all was played"
    FAILED = "the file cannot be played"


class RecordingPlayer:
    """Delivers the batches of a recording, bit for bit as subscribers of the device got them.

    Args:
        path: the file; if it contains several devices, the first is played.
        deliver: called on the event loop with each batch.
        pace: at which batches are delivered.
        clock: a steady clock, s.
        sleep: waits for that clock, s.

    Attributes:
        state: of the playback.
        configuration: the last recorded one; set before the batches for which it holds are delivered.
        problem: what is wrong, "" if nothing is; a truncated recording is reported once all of it was played.
    """

    def __init__(
        self,
        path: Path,
        deliver: Callable[[pb.RangeBatch], None],
        pace: Pace = Pace.AS_RECORDED,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        self.state = PlaybackState.WAITING
        self.configuration: pb.DeviceConfiguration | None = None
        self.problem = ""
        self._path = path
        self._deliver = deliver
        self._pace = pace
        self._clock = clock
        self._sleep = sleep
        self._topic = ""
        self._unreadable = 0
        self._due = self._time = 0.0

    async def run(self) -> None:
        """Plays the file once, and ends in the state ENDED or FAILED."""
        self.state = PlaybackState.PLAYING
        reader = RecordingReader(self._path)
        messages = iter(reader)
        try:
            while block := await asyncio.to_thread(lambda: list(islice(messages, _READ_AHEAD))):
                for message in block:
                    await self._play(message)
        except OSError as error:
            self._fail(f"The recording {self._path} cannot be read: {error.strerror}.")
        except InvalidInput as error:
            self._fail(error.detail)
        else:
            self._end(reader)

    async def _play(self, message: Recorded) -> None:
        try:
            if message.schema == CONFIGURATION:
                self.configuration = pb.DeviceConfiguration.FromString(message.data)
            elif message.schema == RANGES:
                if not self._topic:
                    check_ranges(message, self._path)
                    self._topic = message.topic
                    self._due, self._time = self._clock(), message.time / 1e9
                if message.topic == self._topic:
                    batch = pb.RangeBatch.FromString(message.data)
                    await self._sleep(self._delay(message.time / 1e9))
                    self._deliver(batch)
        except DecodeError:
            self._unreadable += 1

    def _delay(self, t: float) -> float:
        """Seconds until a batch of the recorded time `t`, s, is due."""
        if self._pace is Pace.AT_ONCE:
            return 0.0
        self._due += min(max(t - self._time, 0.0), LONGEST_GAP)
        self._time = t
        return max(self._due - self._clock(), 0.0)

    def _end(self, reader: RecordingReader) -> None:
        if not self._topic:
            self._fail(f"{self._path} holds no batch of ranges.")
            return
        problems = []
        if reader.torn_bytes:
            problems.append(f"The recording is cut off: its last {reader.torn_bytes} bytes are no whole record.")
        elif not reader.complete:
            problems.append("The recording has no end: it was cut off, or is still being written.")
        if self._unreadable:
            problems.append(f"{self._unreadable} of its messages are damaged and were left out.")
        self.problem = " ".join(problems)
        self.state = PlaybackState.ENDED

    def _fail(self, problem: str) -> None:
        self.state, self.problem = PlaybackState.FAILED, problem
