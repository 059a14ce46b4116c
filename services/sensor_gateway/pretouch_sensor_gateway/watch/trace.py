"""The recent ranges, summarised over short spans of time, as a sparkline shows them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array

SPAN = 0.25
"""Seconds of one span."""
SPANS = 960
"""Spans that are kept: 4 minutes."""


@dataclass(frozen=True, eq=False)
class Summary:
    """The ranges of k modules over n spans of time.

    Attributes:
        measurements: (n,) how many in each.
        returns: (n, k) how many of these have a range.
        mean: (n, k) m, the mean of those ranges; NaN where there was none.
    """

    measurements: NDArray[np.int64]
    returns: NDArray[np.int64]
    mean: Array


@dataclass
class _Span:
    returns: NDArray[np.int64]
    total: Array
    measurements: int = 0


@dataclass
class Trace:
    """Ranges of `modules` modules; times are s on the device's gateway."""

    modules: int
    _spans: dict[int, _Span] = field(default_factory=dict)
    _newest: int | None = None

    def add(self, t: Array, ranges: Array) -> None:
        """Adds measurements at times t (f,), with ranges (f, k), m, NaN for a miss.

        Times that go back by more than is kept clear the trace: the clock was set.
        """
        index = np.floor(t / SPAN).astype(np.int64)
        for k in np.unique(index).tolist():
            if self._newest is not None and k <= self._newest - SPANS:
                self._spans.clear()
                self._newest = None
            rows = ranges[index == k]
            span = self._spans.get(k)
            if span is None:
                span = self._spans[k] = _Span(np.zeros(self.modules, np.int64), np.zeros(self.modules))
            span.measurements += len(rows)
            span.returns += np.isfinite(rows).sum(axis=0)
            span.total += np.nansum(rows, axis=0)
            self._newest = k if self._newest is None else max(k, self._newest)
        self._forget()

    def latest(self, now: float, count: int, joined: int = 1) -> Summary:
        """Summarises the last `count` columns that are complete at time `now`, oldest first.

        Args:
            joined: spans per column. They are grouped alike at any time, so that columns move but do not change.
        """
        measurements = np.zeros(count, np.int64)
        returns = np.zeros((count, self.modules), np.int64)
        total = np.zeros((count, self.modules))
        first = (int(np.floor(now / SPAN)) // joined - count) * joined
        for k in range(count * joined):
            if span := self._spans.get(first + k):
                measurements[k // joined] += span.measurements
                returns[k // joined] += span.returns
                total[k // joined] += span.total
        mean = np.divide(total, returns, out=np.full_like(total, np.nan), where=returns > 0)
        return Summary(measurements, returns, mean)

    def recent(self, now: float, seconds: float) -> tuple[int, NDArray[np.int64]]:
        """How many measurements there were in about the last `seconds`, and how many ranges of each module (k,)."""
        summary = self.latest(now, round(seconds / SPAN))
        return int(summary.measurements.sum()), summary.returns.sum(axis=0)

    def _forget(self) -> None:
        if self._newest is not None:
            for k in [k for k in self._spans if k <= self._newest - SPANS]:
                del self._spans[k]
