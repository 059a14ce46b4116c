"""Builds batches from timestamped measurements: calibrates their ranges, and flags the doubtful ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pretouch_sensor_gateway.calibration.model import Calibration
from pretouch_sensor_gateway.clock_sync import Timestamp
from pretouch_sensor_gateway.jump_detector import JumpDetector
from pretouch_sensor_gateway.range_batch import Flag, RangeBatch
from pretouch_sensor_gateway.sequence_tracker import TrackedMeasurement

_JUMP, _WARMING_UP = np.uint8(Flag.JUMP), np.uint8(Flag.WARMING_UP)


class BatchBuilder:
    """Builds the batches of one device.

    Attributes:
        calibration: of its modules; None: ranges are taken as the device reports them.
    """

    def __init__(self, calibration: Calibration | None) -> None:
        self.calibration = calibration
        self._jump_detector = JumpDetector()

    def restart(self) -> None:
        """Forgets earlier ranges: the device restarted."""
        self._jump_detector.restart()

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
        jumps = [self._jump_detector.detect(*row) for row in zip(ranges.tolist(), status.tolist(), strict=True)]
        flags = np.array(jumps, dtype=np.uint8) * _JUMP
        if warming_up:
            flags |= _WARMING_UP
        return RangeBatch(
            t=np.array([time.t for time in times]),
            time_std=max(time.std for time in times),
            sequence=np.array([one.sequence for one in tracked], dtype=np.uint32),
            epoch=epoch,
            range=ranges,
            raw=raw,
            status=status,
            flags=flags,
            lost=lost,
            wire_format=wire_format,
        )
