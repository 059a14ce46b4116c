"""The last ten minutes of one device: its measurements, and the tip poses that robots told."""

from __future__ import annotations

from collections import deque

import numpy as np

from pretouch_sensor_gateway.batch import Batch
from pretouch_sensor_gateway.frames import Frames
from pretouch_sensor_gateway.poses import PosePath

SPAN = 600.0
"""Seconds remembered."""
MAX_FRAMES = 131_072
"""Measurements remembered: `SPAN` at 200 Hz; of a faster device less time is remembered."""
_FIRST_CAPACITY = 1024
MAX_PATHS = 16
"""Pose paths remembered, one for each robot's call that told any; the oldest goes."""


class History:
    """What a later question may be about; bounded in time and number.

    Measurements lie in one ring of fixed-size rows, which takes 4 MB for ten minutes of six modules at 30 Hz. A device
    that changes its number of modules is another device: what was before is forgotten.
    """

    def __init__(self) -> None:
        self._rows = np.zeros(0, dtype=_row(0))
        self._modules = 0
        self._count = 0  # rows ever written to this ring
        self._paths: deque[PosePath] = deque(maxlen=MAX_PATHS)

    def add(self, batch: Batch) -> None:
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
            )
            self._count += 1

    def remember(self, path: PosePath) -> None:
        """Keeps `path`, which may go on growing."""
        self._paths.append(path)

    def between(self, start: float, end: float) -> tuple[Frames, list[PosePath]]:
        """Copies of the measurements within the span, s since the Unix epoch, and of the paths, the newest first."""
        rows = self._rows[: self._count]
        rows = rows[(rows["t"] >= max(start, self._newest() - SPAN)) & (rows["t"] <= end)]
        rows = rows[np.argsort(rows["t"], kind="stable")]
        frames = Frames(rows["t"], rows["time_std"], rows["range"], rows["status"], rows["flags"])
        return frames, [path.between(start, end) for path in reversed(self._paths)]

    def _newest(self) -> float:
        return float(self._rows["t"][(self._count - 1) % len(self._rows)]) if self._count else 0.0

    def _make_room(self, t: float) -> None:
        """Doubles a full ring whose oldest row is still to be remembered when one of time `t` is written."""
        size = len(self._rows)
        if self._count < size or self._count % size or size >= MAX_FRAMES:
            return
        if abs(t - float(self._rows["t"][0])) <= SPAN:
            self._rows = np.concatenate([self._rows, np.zeros(size, dtype=self._rows.dtype)])
            self._count = size


def _row(modules: int) -> np.dtype[np.void]:
    return np.dtype(
        [
            ("t", "f8"),
            ("time_std", "f8"),
            ("range", "f8", (modules,)),
            ("status", "u1", (modules,)),
            ("flags", "u1", (modules,)),
        ]
    )
