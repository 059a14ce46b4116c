"""What each module of a device has measured so far, and how fast measurements come."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from pretouch_sensor_gateway.batch import Batch, Flag
from pretouch_sensor_gateway.wire_formats.received import OK

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
        returned = (batch.status == OK) & np.isfinite(batch.range)
        counts = zip(returned.sum(axis=0), ((batch.flags & Flag.JUMP) != 0).sum(axis=0), strict=True)
        for k, (returns, jumps) in enumerate(counts):
            module = self.modules[k]
            module.range, module.status = float(batch.range[-1, k]), int(batch.status[-1, k])
            module.measurements += len(batch)
            module.returns += int(returns)
            module.jumps += int(jumps)
        self._recent.append((at, len(batch)))
        self._forget(at)

    def rate(self, at: float) -> float:
        """Measurements a second over the last five seconds before `at`."""
        self._forget(at)
        return sum(count for _, count in self._recent) / _RATE_SPAN

    def _forget(self, at: float) -> None:
        while self._recent and self._recent[0][0] < at - _RATE_SPAN:
            self._recent.popleft()
