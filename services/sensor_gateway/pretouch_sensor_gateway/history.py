"""The last ten minutes of one device: its measurements, and the tip poses that robots sent."""

from __future__ import annotations

from collections import deque

import numpy as np

from pretouch_sensor_gateway.measurements import Measurements
from pretouch_sensor_gateway.pose_path import PosePath
from pretouch_sensor_gateway.range_batch import RangeBatch

SPAN = 600.0
"""Seconds remembered."""
MAX_MEASUREMENTS = 131_072
"""Measurements remembered: `SPAN` at 200 Hz; of a faster device less time is remembered."""
_FIRST_CAPACITY = 1024
MAX_PATHS = 16
"""Pose paths remembered, one for each StreamPoints call that sent poses; beyond that the oldest goes."""


class History:
    """Keeps what GetSamples may ask for; bounded in time and number.

    Measurements are stored in one ring buffer of fixed-size rows, which takes 4 MB for ten minutes of six modules at
    30 Hz. A device that changes its number of modules is another device: the measurements before are forgotten.
    """

    def __init__(self) -> None:
        self._rows = np.zeros(0, dtype=_row(0))
        self._modules = 0
        self._count = 0  # rows ever written to this ring buffer
        self._paths: deque[PosePath] = deque(maxlen=MAX_PATHS)

    def add(self, batch: RangeBatch) -> None:
        if batch.modules != self._modules or not len(self._rows):
            self._rows = np.zeros(_FIRST_CAPACITY, dtype=_row(batch.modules))
            self._modules, self._count = batch.modules, 0
        for index in range(len(batch)):
            self._make_room(batch.t[index])
            self._rows[self._count % len(self._rows)] = (
                batch.t[index],
                batch.time_std,
                batch.range[index],
                batch.status[index],
                batch.flags[index],
                batch.std[index],
            )
            self._count += 1

    def add_path(self, path: PosePath) -> None:
        """Remembers `path`, to which poses may still be appended."""
        self._paths.append(path)

    def remove_path(self, path: PosePath) -> None:
        """Forgets `path`, whose times turned out to be wrong."""
        if path in self._paths:
            self._paths.remove(path)

    def between(self, start: float, end: float) -> tuple[Measurements, list[PosePath]]:
        """Copies of the measurements between two Unix times, s, and of the paths, the newest path first."""
        rows = self._rows[: self._count]
        rows = rows[(rows["t"] >= max(start, self._newest() - SPAN)) & (rows["t"] <= end)]
        rows = rows[np.argsort(rows["t"], kind="stable")]
        measurements = Measurements(*(rows[name] for name in _COLUMNS))
        return measurements, [path.between(start, end) for path in reversed(self._paths)]

    def _newest(self) -> float:
        return float(self._rows["t"][(self._count - 1) % len(self._rows)]) if self._count else 0.0

    def _make_room(self, t: float) -> None:
        """Doubles a full ring buffer whose oldest row must still be remembered when a row of time `t` is written."""
        size = len(self._rows)
        if self._count < size or self._count % size or size >= MAX_MEASUREMENTS:
            return
        if abs(t - float(self._rows["t"][0])) <= SPAN:
            self._rows = np.concatenate([self._rows, np.zeros(size, dtype=self._rows.dtype)])
            self._count = size


_COLUMNS = ("t", "time_std", "range", "status", "flags", "std")


def _row(modules: int) -> np.dtype[np.void]:
    return np.dtype(
        [
            ("t", "f8"),
            ("time_std", "f8"),
            ("range", "f8", (modules,)),
            ("status", "u1", (modules,)),
            ("flags", "u1", (modules,)),
            ("std", "f4", (modules,)),
        ]
    )
