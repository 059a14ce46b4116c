"""One finger as the gateway serves it: its batches go to the subscribers, the history and the recording."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from pretouch.errors import InvalidInput
from pretouch.geometry import Pose
from pretouch.tof import Sensor
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.recording_pb2 import RecordedTipPoses
from pretouch.wire.common import pose_from_proto, pose_to_proto
from pretouch_sensor_gateway.calibration.model import Calibration
from pretouch_sensor_gateway.calibration.proto_conversion import calibration_from_proto, calibration_to_proto
from pretouch_sensor_gateway.calibration.sensor import describe_sensor
from pretouch_sensor_gateway.device_statistics import DeviceStatistics, ModuleStatistics
from pretouch_sensor_gateway.fusion import FusedSamples
from pretouch_sensor_gateway.history import History
from pretouch_sensor_gateway.pose_path import PosePath
from pretouch_sensor_gateway.range_batch import RangeBatch
from pretouch_sensor_gateway.recording.queue_items import PointsItem, TipPosesItem
from pretouch_sensor_gateway.recording.recorder import Recorder
from pretouch_sensor_gateway.source import DeviceState, Source, SourceStatus
from pretouch_sensor_gateway.subscription_queue import SubscriptionQueue


@dataclass(frozen=True)
class DeviceStatus:
    """The status of a device.

    Attributes:
        modules: statistics of each.
        rate: measurements a second.
        subscribers: streams open at this moment.
        overrun: measurements that slow subscribers lost, all together, since the gateway started.
    """

    source: SourceStatus
    modules: Sequence[ModuleStatistics]
    rate: float
    subscribers: int
    overrun: int


class Device:
    """A finger that the gateway serves.

    Args:
        tip_T_module: pose of each module in the tip's coordinate frame.
        calibration: of its modules; None: ranges are taken as the device reports them.
        recorder: None where the gateway has no folder to record to.

    Attributes:
        name: as requests use it.
        address: of its port or recording, as configured.
        source: where its batches come from. It calls `deliver`, and is set after construction, before `run`.
        history: its last minutes.
        recorded_path: of the tip, from the recording that stands in for the device; None for a device on a port.
        recorded_time_std: one standard deviation of the times on it, s.
    """

    source: Source

    def __init__(
        self,
        name: str,
        address: str,
        tip_T_module: Sequence[Pose],
        calibration: Calibration | None,
        recorder: Recorder | None,
    ) -> None:
        self.name = name
        self.address = address
        self.history = History()
        self.recorded_path: PosePath | None = None
        self.recorded_time_std = 0.0
        self._recorded_call = 0
        self._calls = 0
        self.tip_T_module = tuple(tip_T_module)
        self.calibration = calibration
        self.recorder = recorder
        self._subscriptions: set[SubscriptionQueue] = set()
        self._overrun = 0  # of subscribers that have gone
        self._statistics = DeviceStatistics()
        self._range_std = float("nan")  # of the newest batch that tells it
        self._record_configuration()

    async def run(self) -> None:
        """Runs the source until cancelled, or until the recording ends."""
        await self.source.run()
        self.wake_subscribers()

    @property
    def ended(self) -> bool:
        """Whether no more batches will come."""
        return self.source.status().state is DeviceState.ENDED

    def count_call(self) -> int:
        """The number of a StreamPoints call that begins, by which a recording tells its tip poses from another's."""
        self._calls += 1
        return self._calls

    @contextmanager
    def subscribe(self) -> Iterator[SubscriptionQueue]:
        """Subscribes to all batches from now on, for as long as the block lasts."""
        subscription = SubscriptionQueue()
        self._subscriptions.add(subscription)
        try:
            yield subscription
        finally:
            self._subscriptions.discard(subscription)
            self._overrun += subscription.overrun

    def deliver(self, batch: RangeBatch) -> None:
        """Passes a batch to the statistics, the history, all subscribers and the recorder."""
        self._statistics.add(batch, time.monotonic())
        self.history.add(batch)
        known = batch.std[np.isfinite(batch.std)]
        if len(known):
            self._range_std = float(np.sqrt(np.mean(np.square(known, dtype=np.float64))))
        for subscription in self._subscriptions:
            subscription.put(batch)
        if self.recorder is not None and self.recorder.on:
            self.recorder.record_batch(batch.message)

    def configure_as_recorded(self, configuration: pb.DeviceConfiguration) -> None:
        """Takes over the modules' poses and the calibration of a recording that stands in for the device.

        Raises:
            InvalidInput: an invalid pose or calibration; nothing is changed.
        """
        poses = [pose_from_proto(pose, f"tip_t_module[{k}]") for k, pose in enumerate(configuration.tip_t_module)]
        calibration = (
            calibration_from_proto(configuration.calibration) if configuration.HasField("calibration") else None
        )
        self.tip_T_module, self.calibration = tuple(poses) or self.tip_T_module, calibration
        self._record_configuration()

    def follow_recorded_tip(self, poses: RecordedTipPoses) -> None:
        """Remembers tip poses of a recording that stands in for the device, as if a robot had sent them now.

        Raises:
            InvalidInput: an invalid pose.
        """
        if self.recorded_path is None or poses.call != self._recorded_call:
            self._recorded_call, self.recorded_path = poses.call, PosePath()
            self.history.add_path(self.recorded_path)
        self.recorded_time_std = poses.time_std
        for tip in poses.tip_poses:
            self.recorded_path.append(tip.t, pose_from_proto(tip.base_t_tip, "base_t_tip"))

    def record_tip_poses(self, poses: RecordedTipPoses) -> None:
        """Records tip poses of which points will come, if the device is being recorded."""
        if self.recorder is not None and poses.tip_poses:
            self.recorder.record_fusion(TipPosesItem(poses))

    def record_points(self, fused: FusedSamples) -> None:
        """Records samples that were fused with recorded tip poses."""
        if self.recorder is not None and len(fused.samples):
            self.recorder.record_fusion(PointsItem(fused))

    def record_event(self, text: str) -> None:
        """Records that something happened to the device, if it is being recorded."""
        if self.recorder is not None:
            self.recorder.record_event(text, time.time())

    def wake_subscribers(self) -> None:
        """Wakes every subscriber, though there may be nothing new to take."""
        for subscription in self._subscriptions:
            subscription.changed.set()

    def configure(
        self, tip_T_module: Sequence[Pose] | None, calibration: Calibration | None, recording: bool | None
    ) -> None:
        """Changes what is given, leaves the rest as it is, and records the new configuration.

        Raises:
            InvalidInput: there is no folder to record to.
        """
        if recording and self.recorder is None:
            raise InvalidInput(
                "The gateway has no folder to record to.", "Start it with a [recording] folder in its configuration."
            )
        if tip_T_module:
            self.tip_T_module = tuple(tip_T_module)
        if calibration is not None:
            self.calibration = calibration
            self.source.calibrate(calibration)
        if recording is not None and self.recorder is not None:
            self.recorder.start() if recording else self.recorder.stop()
        self._record_configuration()

    def configuration(self) -> pb.DeviceConfiguration:
        """The present configuration, as GetStatus and recordings contain it."""
        return pb.DeviceConfiguration(
            tip_t_module=[pose_to_proto(pose) for pose in self.tip_T_module],
            calibration=None if self.calibration is None else calibration_to_proto(self.calibration),
            recording=self.recorder is not None and self.recorder.on,
        )

    def sensor(self) -> Sensor | None:
        """What a session may state as its sensor; None while the noise or the rate is not known."""
        rate = self._statistics.rate(time.monotonic())
        if not math.isfinite(self._range_std) or rate <= 0:
            return None
        return describe_sensor(self.calibration, self.tip_T_module, self._range_std, rate)

    def now(self) -> float:
        """The present, Unix time, s, by the clock of the device's batches."""
        return self.source.now()

    def status(self) -> DeviceStatus:
        return DeviceStatus(
            source=self.source.status(),
            modules=self._statistics.modules,
            rate=self._statistics.rate(time.monotonic()),
            subscribers=len(self._subscriptions),
            overrun=self._overrun + sum(subscription.overrun for subscription in self._subscriptions),
        )

    def _record_configuration(self) -> None:
        if self.recorder is not None:
            self.recorder.record_configuration(self.configuration(), time.time())
