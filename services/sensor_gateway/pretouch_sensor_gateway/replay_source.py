"""A recording in a device's place: the same batches, bit for bit, with the times and epochs that they had."""

from __future__ import annotations

from pathlib import Path

from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.recording_pb2 import RecordedTipPoses
from pretouch_sensor_gateway.calibration.model import Calibration
from pretouch_sensor_gateway.device import Device
from pretouch_sensor_gateway.pose_path import PosePath
from pretouch_sensor_gateway.range_batch import RangeBatch
from pretouch_sensor_gateway.recording.player import PlaybackState, Played, RecordingPlayer
from pretouch_sensor_gateway.recording.validation import check_recording
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
        path: the recording.
        device: which is configured as it was when the recording was made.

    Raises:
        InvalidInput: the recording cannot be played.
    """

    def __init__(self, path: Path, device: Device) -> None:
        beginning = check_recording(path)
        device.configure_as_recorded(beginning.configuration)
        device.recorded_path = PosePath()
        self._device = device
        self._player = RecordingPlayer(path, self._play)
        self._now = beginning.time
        self._last: RangeBatch | None = None
        self._measurements = self._lost = 0

    async def run(self) -> None:
        await self._player.run()

    def calibrate(self, calibration: Calibration | None) -> None:
        """Changes nothing: recorded ranges stay as they are."""

    def now(self) -> float:
        return self._now

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
                self._device.configure_as_recorded(message)
            case RecordedTipPoses():
                self._device.follow_recorded_tip(message)
            case pb.RangeBatch():
                self._last = batch = RangeBatch.from_message(message)
                self._now = float(batch.t[-1]) if len(batch) else self._now
                self._measurements += len(batch)
                self._lost += batch.lost
                self._device.deliver(batch)
