"""Which region to scan next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pretouch.session import Planner, Region
from pretouch.trajectory import Trajectory

_ALIKE = 1e-4
"""m: expected errors that differ by less count as the same; then the gain per robot second decides."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A region that could be scanned next, its expected error predicted, and the path that would do it."""

    region: Region
    path: Trajectory


def choose(
    candidates: Sequence[Candidate], planner: Planner, present_error: float, fits: Callable[[Candidate], bool]
) -> Candidate | None:
    """The best candidate that fits the budget; None when none does.

    `information`: the least predicted expected error. `confidence`: the proposer's order.

    Args:
        present_error: m, the estimate's expected error without another scan.
    """
    order = _by_confidence if planner is Planner.CONFIDENCE else _by_information(candidates, present_error)
    return next((candidate for candidate in sorted(candidates, key=order) if fits(candidate)), None)


def _by_confidence(candidate: Candidate) -> tuple[float, float]:
    return -candidate.region.confidence, 0.0


def _by_information(
    candidates: Sequence[Candidate], present_error: float
) -> Callable[[Candidate], tuple[float, float]]:
    least = min((candidate.region.expected_error for candidate in candidates), default=0.0)

    def order(candidate: Candidate) -> tuple[float, float]:
        error = candidate.region.expected_error
        return float(np.floor((error - least) / _ALIKE)), -(present_error - error) / candidate.path.duration

    return order
