"""One finger as the gateway's clients see it: its batches to everyone who listens, its history, its recording."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from pretouch.errors import InvalidInput
from pretouch.geometry import Array, Pose
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import pose_to_proto
from pretouch_sensor_gateway.calibration.model import UNCALIBRATED, Calibration
from pretouch_sensor_gateway.calibration.wire import calibration_to_proto
from pretouch_sensor_gateway.history import History
from pretouch_sensor_gateway.recording.recorder import Recorder
from pretouch_sensor_gateway.source import Source, SourceStatus
from pretouch_sensor_gateway.subscription import Delivery, Subscription
from pretouch_sensor_gateway.tally import ModuleTally, Tally


@dataclass(frozen=True)
class DeviceStatus:
    """How a device fares.

    Attributes:
        modules: counts of each.
        rate: measurements a second.
        subscribers: listeners at this moment.
        overrun: frames that listeners lost by being slow, all together, since the gateway started.
    """

    source: SourceStatus
    modules: Sequence[ModuleTally]
    rate: float
    subscribers: int
    overrun: int


class Device:
    """A finger that the gateway serves.

    Args:
        tip_T_module: pose of each module in the tip frame.
        calibration: of its modules; None: ranges are taken as the device tells them.
        recorder: None where the gateway has no folder to record to.

    Attributes:
        name: what requests call it.
        address: where it is, as configured.
        source: where its batches come from; to be set before `run`, and to call `deliver`.
        history: its last minutes.
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
        self.tip_T_module = tuple(tip_T_module)
        self.calibration = calibration
        self.recorder = recorder
        self._subscriptions: set[Subscription] = set()
        self._overrun = 0  # of listeners that have gone
        self._tally = Tally()
        self._tell_recorder()

    async def run(self) -> None:
        """Listens to the device until cancelled."""
        await self.source.run()

    @contextmanager
    def subscribed(self) -> Iterator[Subscription]:
        """A subscription to all batches from now on, for as long as the block lasts."""
        subscription = Subscription()
        self._subscriptions.add(subscription)
        try:
            yield subscription
        finally:
            self._subscriptions.discard(subscription)
            self._overrun += subscription.overrun

    def deliver(self, delivery: Delivery) -> None:
        """Gives a batch to everyone who wants it."""
        self._tally.add(delivery.batch, time.monotonic())
        self.history.add(delivery.batch)
        for subscription in self._subscriptions:
            subscription.offer(delivery)
        if self.recorder is not None and self.recorder.on:
            self.recorder.batch(delivery.message)

    def happened(self, text: str) -> None:
        """Tells the recording, if there is one, that something happened to the device."""
        if self.recorder is not None:
            self.recorder.event(text, time.time())

    def wake(self) -> None:
        """Lets every listener look up, though there may be nothing new."""
        for subscription in self._subscriptions:
            subscription.changed.set()

    def configure(
        self, tip_T_module: Sequence[Pose] | None, calibration: Calibration | None, recording: bool | None
    ) -> None:
        """Changes what is given, and leaves the rest as it is. A recording tells the change.

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
        self._tell_recorder()

    def configuration(self) -> pb.DeviceConfiguration:
        """What now holds, as GetStatus and recordings tell it."""
        return pb.DeviceConfiguration(
            tip_t_module=[pose_to_proto(pose) for pose in self.tip_T_module],
            calibration=None if self.calibration is None else calibration_to_proto(self.calibration),
            recording=self.recorder is not None and self.recorder.on,
        )

    def std_at(self, ranges: Array) -> Array:
        """One standard deviation (f, k), m, of ranges (f, k), m."""
        if self.calibration is None or len(self.calibration.modules) != ranges.shape[1]:
            return np.asarray(UNCALIBRATED.std_at(ranges))
        return self.calibration.std_at(ranges)

    def now(self) -> float:
        """The present, s since the Unix epoch, by the clock of the device's batches."""
        return self.source.now()

    def status(self) -> DeviceStatus:
        return DeviceStatus(
            source=self.source.status(),
            modules=self._tally.modules,
            rate=self._tally.rate(time.monotonic()),
            subscribers=len(self._subscriptions),
            overrun=self._overrun + sum(subscription.overrun for subscription in self._subscriptions),
        )

    def _tell_recorder(self) -> None:
        if self.recorder is not None:
            self.recorder.configuration(self.configuration(), time.time())
