"""Plays a recording as if it were the device."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from enum import Enum
from itertools import islice
from pathlib import Path

from google.protobuf.message import DecodeError

from pretouch.errors import InvalidInput, PretouchError
from pretouch.recording.reader import Recorded, RecordingReader
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.recording_pb2 import RecordedTipPoses
from pretouch_sensor_gateway.recording.validation import CONFIGURATION, RANGES, check_ranges

LONGEST_GAP = 10.0
"""Longest pause between two batches, s: longer gaps in the recording are shortened to this."""
_READ_AHEAD = 256

Played = pb.RangeBatch | pb.DeviceConfiguration | RecordedTipPoses
"""What a recording is played from; what else is in it can be computed again."""
_TIP_POSES = RecordedTipPoses.DESCRIPTOR.full_name


class PlaybackState(Enum):
    """The state of a playback."""

    WAITING = "not begun"
    PLAYING = "batches come"
    ENDED = "all was played"
    FAILED = "the file cannot be played"


class RecordingPlayer:
    """Delivers the batches of a recording, bit for bit as subscribers of the device got them, at their pace.

    Configurations and tip poses are delivered where they stand between the batches.

    Args:
        path: the file; if it contains several devices, the first is played.
        deliver: called on the event loop with each message; a PretouchError says that it is damaged.
        clock: a steady clock, s.
        sleep: waits for that clock, s.

    Attributes:
        state: of the playback.
        problem: what is wrong, "" if nothing is; a truncated recording is reported once all of it was played.
    """

    def __init__(
        self,
        path: Path,
        deliver: Callable[[Played], None],
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        self.state = PlaybackState.WAITING
        self.problem = ""
        self._path = path
        self._deliver = deliver
        self._clock = clock
        self._sleep = sleep
        self._device = ""  # the first part of the topics
        self._began = False
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
        if message.schema not in (CONFIGURATION, RANGES, _TIP_POSES):
            return
        device = message.topic.rpartition("/")[0]
        self._device = self._device or device
        if device != self._device:
            return
        if message.schema == RANGES and not self._began:
            check_ranges(message, self._path)
            self._began = True
            self._due, self._time = self._clock(), message.time / 1e9
        try:
            if message.schema == CONFIGURATION:
                self._deliver(pb.DeviceConfiguration.FromString(message.data))
            elif message.schema == _TIP_POSES:
                self._deliver(RecordedTipPoses.FromString(message.data))
            else:
                batch = pb.RangeBatch.FromString(message.data)
                await self._sleep(self._delay(message.time / 1e9))
                self._deliver(batch)
        except (DecodeError, PretouchError):
            self._unreadable += 1

    def _delay(self, t: float) -> float:
        """Seconds until a batch of the recorded time `t`, s, is due."""
        self._due += min(max(t - self._time, 0.0), LONGEST_GAP)
        self._time = t
        return max(self._due - self._clock(), 0.0)

    def _end(self, reader: RecordingReader) -> None:
        if not self._began:
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
