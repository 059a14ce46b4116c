"""Measurements as columns, without the batches that they came in: what the history keeps and the fusion reads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_sensor_gateway.range_batch import RangeBatch


@dataclass(frozen=True, eq=False)
class Measurements:
    """f measurements of k modules.

    Attributes:
        t: (f,) Unix time, s.
        time_std: (f,) s, one standard deviation of t.
        range: (f, k) m, NaN where a module had none.
        status: (f, k) uint8, 0 is good.
        flags: (f, k) uint8, of `range_batch.Flag`.
        std: (f, k) float32, m, one standard deviation of each range; NaN where it is not known.
    """

    t: Array
    time_std: Array
    range: Array
    status: NDArray[np.uint8]
    flags: NDArray[np.uint8]
    std: NDArray[np.float32]

    @staticmethod
    def from_batch(batch: RangeBatch) -> Measurements:
        """All of a batch."""
        time_std = np.full(len(batch), batch.time_std)
        return Measurements(batch.t, time_std, batch.range, batch.status, batch.flags, batch.std)

    @staticmethod
    def empty(modules: int = 0) -> Measurements:
        """No measurement at all."""
        codes = np.zeros((0, modules), dtype=np.uint8)
        ranges = np.zeros((0, modules))
        return Measurements(np.zeros(0), np.zeros(0), ranges, codes, codes, ranges.astype(np.float32))

    @staticmethod
    def concatenate(parts: Sequence[Measurements]) -> Measurements:
        """All of `parts`, which have equally many modules, in their order."""
        return Measurements(
            np.concatenate([part.t for part in parts]),
            np.concatenate([part.time_std for part in parts]),
            np.concatenate([part.range for part in parts]),
            np.concatenate([part.status for part in parts]),
            np.concatenate([part.flags for part in parts]),
            np.concatenate([part.std for part in parts]),
        )

    def select(self, which: slice | NDArray[np.bool_] | NDArray[np.int64]) -> Measurements:
        """Those measurements."""
        return Measurements(
            self.t[which],
            self.time_std[which],
            self.range[which],
            self.status[which],
            self.flags[which],
            self.std[which],
        )

    def __len__(self) -> int:
        return len(self.t)

    @property
    def modules(self) -> int:
        return int(self.range.shape[1])
