"""Timed measurements become a batch: calibrated, and with what is doubtful flagged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pretouch_sensor_gateway.batch import Batch, Flag
from pretouch_sensor_gateway.calibration.model import Calibration
from pretouch_sensor_gateway.jumps import Jumps
from pretouch_sensor_gateway.wire_formats.received import Measurement

_JUMP, _WARMING_UP = np.uint8(Flag.JUMP), np.uint8(Flag.WARMING_UP)


@dataclass(frozen=True)
class Timed:
    """A measurement with its place in the epoch and its time, s since the Unix epoch; one sigma of it, s."""

    measurement: Measurement
    sequence: int
    t: float
    time_std: float


class Assembler:
    """Makes the batches of one device.

    Attributes:
        calibration: of its modules; None: ranges are taken as the device tells them.
    """

    def __init__(self, calibration: Calibration | None) -> None:
        self.calibration = calibration
        self._jumps = Jumps()

    def restart(self) -> None:
        """The device started anew: no range of before says what to expect."""
        self._jumps.restart()

    def describes(self, modules: int) -> bool:
        """Whether the calibration, if there is one, is of that many modules."""
        return self.calibration is None or len(self.calibration.modules) == modules

    def batch(self, measured: Sequence[Timed], epoch: int, age: float, lost: int) -> Batch:
        """One batch of measurements of equally many modules.

        Args:
            age: s since the epoch was first heard.
            lost: measurements missing before the last of these.
        """
        raw = np.array([timed.measurement.ranges for timed in measured])
        status = np.array([timed.measurement.status for timed in measured], dtype=np.uint8)
        ranges = raw if self.calibration is None else self.calibration.distance(raw)
        warming_up = self.calibration is not None and age < self.calibration.warm_up
        judged = [self._jumps.judge(*row) for row in zip(ranges.tolist(), status.tolist(), strict=True)]
        flags = np.array(judged, dtype=np.uint8) * _JUMP
        if warming_up:
            flags |= _WARMING_UP
        return Batch(
            t=np.array([timed.t for timed in measured]),
            time_std=max(timed.time_std for timed in measured),
            sequence=np.array([timed.sequence for timed in measured], dtype=np.uint32),
            epoch=epoch,
            range=ranges,
            raw=raw,
            status=status,
            flags=flags,
            lost=lost,
        )
