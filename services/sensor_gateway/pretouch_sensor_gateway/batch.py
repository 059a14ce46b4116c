"""The unit that flows through the gateway: measurements that came together, with their times."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array


class Flag(IntFlag):
    """What is doubtful about a range whose status is good."""

    JUMP = 1
    """It lies far from the module's last range, and no later one has confirmed it."""
    WARMING_UP = 2
    """The device started so recently that its calibration does not hold yet."""


@dataclass(frozen=True, eq=False)
class Batch:
    """f measurements of k modules, in their order, all of one epoch.

    Attributes:
        t: (f,) s since the Unix epoch on the host clock.
        time_std: one standard deviation of these times, s; an error common to all.
        sequence: (f,) uint32, the device's own count.
        epoch: counts the device's starts.
        range: (f, k) m along each module's beam, calibrated; NaN where it gave none.
        raw: (f, k) m as the device told them.
        status: (f, k) uint8, the modules' status codes; 0 is good.
        flags: (f, k) uint8, of `Flag`.
        lost: measurements missing before the last of these.
    """

    t: Array
    time_std: float
    sequence: NDArray[np.uint32]
    epoch: int
    range: Array
    raw: Array
    status: NDArray[np.uint8]
    flags: NDArray[np.uint8]
    lost: int

    def __len__(self) -> int:
        return len(self.t)

    @property
    def modules(self) -> int:
        return int(self.range.shape[1])
