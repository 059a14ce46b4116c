"""What each module of a device has measured so far, and how fast measurements come."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import isfinite

import numpy as np

from pretouch_sensor_gateway.batch import Batch, Flag
from pretouch_sensor_gateway.wire_formats.received import OK

_JUMP = np.uint8(Flag.JUMP)
_RATE_SPAN = 5.0
"""Seconds over which the rate is taken."""


@dataclass
class ModuleTally:
    """Counts of one module since the gateway started, and its last range (m, NaN = none) and status."""

    range: float = float("nan")
    status: int = 0
    measurements: int = 0
    returns: int = 0
    jumps: int = 0


class Tally:
    """Counts what a device's modules measure.

    Attributes:
        modules: one for each module of the batches so far.
    """

    def __init__(self) -> None:
        self.modules: list[ModuleTally] = []
        self._recent: deque[tuple[float, int]] = deque()

    def add(self, batch: Batch, at: float) -> None:
        """Counts a batch that came at host time `at`, s."""
        while len(self.modules) < batch.modules:
            self.modules.append(ModuleTally())
        rows = zip(batch.range.tolist(), batch.status.tolist(), (batch.flags & _JUMP).tolist(), strict=True)
        for row in rows:
            for module, metres, status, jump in zip(self.modules, *row, strict=False):
                module.range, module.status = metres, status
                module.measurements += 1
                module.returns += status == OK and isfinite(metres)
                module.jumps += jump != 0
        self._recent.append((at, len(batch)))
        self._forget(at)

    def rate(self, at: float) -> float:
        """Measurements a second over the last five seconds before `at`."""
        self._forget(at)
        return sum(count for _, count in self._recent) / _RATE_SPAN

    def _forget(self, at: float) -> None:
        while self._recent and self._recent[0][0] < at - _RATE_SPAN:
            self._recent.popleft()
