"""A recording in a device's place: the same batches, bit for bit, with the times and epochs that they had."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from pretouch.errors import InvalidInput
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.recording_pb2 import RecordedTipPoses
from pretouch_sensor_gateway.calibration.model import Calibration
from pretouch_sensor_gateway.pose_path import PosePath
from pretouch_sensor_gateway.range_batch import RangeBatch
from pretouch_sensor_gateway.recording.player import Played, PlaybackState, RecordingPlayer
from pretouch_sensor_gateway.source import ClockState, DeviceState, SourceStatus

_STATES = {
    PlaybackState.WAITING: DeviceState.CONNECTING,
    PlaybackState.PLAYING: DeviceState.STREAMING,
    PlaybackState.ENDED: DeviceState.ENDED,
    PlaybackState.FAILED: DeviceState.ENDED,
}


class ReplaySource:
    """A `Source` that plays a recording. Its ranges stay as they were recorded, whatever calibration is set.

    Args:
        deliver: gets each batch, on the event loop.
        configure: gets each configuration, before the batches for which it holds.
        follow: gets the tip poses that one StreamPoints call was sent.
    """

    def __init__(
        self,
        path: Path,
        deliver: Callable[[RangeBatch], None],
        configure: Callable[[pb.DeviceConfiguration], None],
        follow: Callable[[RecordedTipPoses], None],
    ) -> None:
        self._player = RecordingPlayer(path, self._play)
        self._deliver = deliver
        self._configure = configure
        self._follow = follow
        self._last: RangeBatch | None = None
        self._measurements = self._lost = 0

    async def run(self) -> None:
        await self._player.run()

    def calibrate(self, calibration: Calibration | None) -> None:
        """Changes nothing: recorded ranges stay as they are."""

    def now(self) -> float:
        return time.time() if self._last is None else float(self._last.t[-1])

    def status(self) -> SourceStatus:
        last = self._last
        return SourceStatus(
            state=_STATES[self._player.state],
            problem=self._player.problem,
            format="recording",
            epoch=0 if last is None else last.epoch,
            measurements=self._measurements,
            lost=self._lost,
            clock=ClockState() if last is None else ClockState(synchronised=True, std=last.time_std),
        )

    def _play(self, message: Played) -> None:
        match message:
            case pb.DeviceConfiguration():
                self._configure(message)
            case RecordedTipPoses():
                self._follow(message)
            case pb.RangeBatch():
                self._last = batch = RangeBatch.from_message(message)
                self._measurements += len(batch)
                self._lost += batch.lost
                self._deliver(batch)
