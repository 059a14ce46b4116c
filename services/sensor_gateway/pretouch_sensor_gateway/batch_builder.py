"""Builds batches from timestamped measurements: calibrates their ranges, and flags the doubtful ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_sensor_gateway.calibration.model import Calibration
from pretouch_sensor_gateway.clock_sync import Timestamp
from pretouch_sensor_gateway.jump_detector import JumpDetector
from pretouch_sensor_gateway.own_noise import OwnNoise
from pretouch_sensor_gateway.range_batch import Flag, RangeBatch
from pretouch_sensor_gateway.sequence_tracker import TrackedMeasurement
from pretouch_sensor_gateway.wire_formats.parser import OK

_JUMP, _WARMING_UP = np.uint8(Flag.JUMP), np.uint8(Flag.WARMING_UP)
_BEYOND, _STD_UNKNOWN = np.uint8(Flag.BEYOND_CALIBRATION), np.uint8(Flag.STD_UNKNOWN)


class BatchBuilder:
    """Builds the batches of one device.

    Attributes:
        calibration: of its modules; None: ranges are taken as the device reports them.
    """

    def __init__(self, calibration: Calibration | None) -> None:
        self.calibration = calibration
        self._jump_detector = JumpDetector()
        self._own_noise = OwnNoise()

    def calibrate(self, calibration: Calibration | None) -> None:
        """Uses another calibration from now on: earlier ranges tell nothing of its own."""
        self.calibration = calibration
        self.restart()

    def restart(self) -> None:
        """Forgets earlier ranges: the device restarted."""
        self._jump_detector.restart()
        self._own_noise.restart()

    def accepts(self, modules: int) -> bool:
        """Whether the calibration, if there is one, is of that many modules."""
        return self.calibration is None or len(self.calibration.modules) == modules

    def build(
        self,
        tracked: Sequence[TrackedMeasurement],
        times: Sequence[Timestamp],
        epoch: int,
        age: float,
        lost: int,
        wire_format: str,
    ) -> RangeBatch:
        """One batch of measurements, all with the same number of modules.

        Args:
            times: when each was made.
            epoch: number of their boot session.
            age: s since the boot session's first measurement was read.
            lost: measurements missing before the last of these.
            wire_format: the name of the device's format.
        """
        raw = np.array([one.measurement.ranges for one in tracked])
        status = np.array([one.measurement.status for one in tracked], dtype=np.uint8)
        ranges = raw if self.calibration is None else self.calibration.distance(raw)
        warming_up = self.calibration is not None and age < self.calibration.warm_up
        t = np.array([time.t for time in times])
        good = np.where(status == OK, ranges, np.nan)
        std = self._std_of(good)
        rows = zip(t.tolist(), good.tolist(), std.tolist(), strict=True)
        flags = np.array([self._jump_detector.detect(*row) for row in rows], dtype=np.uint8) * _JUMP
        flags |= (np.isfinite(good) & np.isnan(std)) * _STD_UNKNOWN
        if self.calibration is not None:
            flags |= self.calibration.beyond(good) * _BEYOND
        if warming_up:
            flags |= _WARMING_UP
        return RangeBatch(
            t=t,
            time_std=max(time.std for time in times),
            sequence=np.array([one.sequence for one in tracked], dtype=np.uint32),
            epoch=epoch,
            range=ranges,
            raw=raw,
            status=status,
            flags=flags,
            lost=lost,
            std=std,
            wire_format=wire_format,
        )

    def _std_of(self, ranges: Array) -> NDArray[np.float32]:
        """(f, k), m, of ranges (f, k), m: by the calibration, or else by the modules' own noise."""
        known = np.full(ranges.shape, np.nan) if self.calibration is None else self.calibration.std_at(ranges)
        if self.calibration is not None and self.calibration.noise_known:
            return known.astype(np.float32)
        own = np.where(np.isnan(ranges), np.nan, self._own_noise.observe(ranges))
        return np.where(np.isnan(known), own, known).astype(np.float32)
