"""A recording in a device's place: the same batches, bit for bit, with the times and epochs that they had."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch_sensor_gateway.batch import Batch
from pretouch_sensor_gateway.calibration.model import Calibration
from pretouch_sensor_gateway.recording.replay import Pace, ReplaySource, ReplayState
from pretouch_sensor_gateway.source import ClockState, DeviceState, SourceStatus
from pretouch_sensor_gateway.subscription import Delivery
from pretouch_sensor_gateway.wire import batch_from_proto

_STATES = {
    ReplayState.WAITING: DeviceState.CONNECTING,
    ReplayState.PLAYING: DeviceState.STREAMING,
    ReplayState.ENDED: DeviceState.ENDED,
    ReplayState.FAILED: DeviceState.ENDED,
}


class ReplayedSource:
    """A `Source` that plays a recording. Its ranges stay as they were recorded, whatever calibration is given."""

    def __init__(self, path: Path, deliver: Callable[[Delivery], None], pace: Pace = Pace.AS_RECORDED) -> None:
        self._replay = ReplaySource(path, self._play, pace)
        self._deliver = deliver
        self._last: Batch | None = None
        self._frames = self._lost = 0

    async def run(self) -> None:
        await self._replay.run()

    def calibrate(self, calibration: Calibration | None) -> None:
        """Changes nothing: what was recorded stays."""

    def now(self) -> float:
        return time.time() if self._last is None else float(self._last.t[-1])

    def status(self) -> SourceStatus:
        last = self._last
        return SourceStatus(
            state=_STATES[self._replay.state],
            problem=self._replay.problem,
            format="recording",
            epoch=0 if last is None else last.epoch,
            frames=self._frames,
            lost=self._lost,
            clock=ClockState() if last is None else ClockState(synchronised=True, std=last.time_std),
        )

    def _play(self, message: pb.RangeBatch) -> None:
        batch = batch_from_proto(message)
        self._last = batch
        self._frames += len(batch)
        self._lost += batch.lost
        self._deliver(Delivery(batch, message))
