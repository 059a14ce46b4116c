"""A recording in a device's place: the same batches, bit for bit, with the times and epochs that they had."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch_sensor_gateway.calibration.model import Calibration
from pretouch_sensor_gateway.range_batch import RangeBatch
from pretouch_sensor_gateway.recording.player import Pace, PlaybackState, RecordingPlayer
from pretouch_sensor_gateway.source import ClockState, DeviceState, SourceStatus

_STATES = {
    PlaybackState.WAITING: DeviceState.CONNECTING,
    PlaybackState.PLAYING: DeviceState.STREAMING,
    PlaybackState.ENDED: DeviceState.ENDED,
    PlaybackState.FAILED: DeviceState.ENDED,
}


class ReplaySource:
    """A `Source` that plays a recording. Its ranges stay as they were recorded, whatever calibration is set."""

    def __init__(self, path: Path, deliver: Callable[[RangeBatch], None], pace: Pace = Pace.AS_RECORDED) -> None:
        self._player = RecordingPlayer(path, self._play, pace)
        self._deliver = deliver
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

    def _play(self, message: pb.RangeBatch) -> None:
        batch = RangeBatch.from_message(message)
        self._last = batch
        self._measurements += len(batch)
        self._lost += batch.lost
        self._deliver(batch)
