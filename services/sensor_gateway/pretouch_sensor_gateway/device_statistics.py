"""What each module of a device has measured so far, and at what rate measurements come."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import isfinite

import numpy as np

from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch_sensor_gateway.range_batch import Flag, RangeBatch
from pretouch_sensor_gateway.wire_formats.parser import OK

_JUMP = np.uint8(Flag.JUMP)
_RATE_SPAN = 5.0
"""Seconds over which the rate is taken."""


@dataclass
class ModuleStatistics:
    """Counts of one module since the gateway started, and its last range (m, NaN: none), status and what it means."""

    range: float = float("nan")
    status: int = 0
    range_status: int = pb.RANGE_STATUS_UNSPECIFIED
    measurements: int = 0
    returns: int = 0
    jumps: int = 0


class DeviceStatistics:
    """Statistics of a device's batches.

    Attributes:
        modules: one for each module of the batches so far.
    """

    def __init__(self) -> None:
        self.modules: list[ModuleStatistics] = []
        self._recent: deque[tuple[float, int]] = deque()

    def add(self, batch: RangeBatch, at: float) -> None:
        """Counts a batch that came at host time `at`, s."""
        while len(self.modules) < batch.modules:
            self.modules.append(ModuleStatistics())
        meanings = batch.range_status.tolist()
        rows = zip(batch.range.tolist(), batch.status.tolist(), meanings, (batch.flags & _JUMP).tolist(), strict=True)
        for row in rows:
            for module, metres, status, meaning, jump in zip(self.modules, *row, strict=False):
                module.range, module.status, module.range_status = metres, status, meaning
                module.measurements += 1
                module.returns += status == OK and isfinite(metres)
                module.jumps += jump != 0
        self._recent.append((at, len(batch)))
        self._forget_before(at - _RATE_SPAN)

    def rate(self, at: float) -> float:
        """Measurements a second over the last five seconds before `at`."""
        self._forget_before(at - _RATE_SPAN)
        return sum(count for _, count in self._recent) / _RATE_SPAN

    def _forget_before(self, start: float) -> None:
        while self._recent and self._recent[0][0] < start:
            self._recent.popleft()
