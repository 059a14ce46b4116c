"""Which region to scan next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pretouch.session import Planner, Region
from pretouch.trajectory import Trajectory

_COMPARED = 8
"""Candidates, those that would tell most, whose costs are compared: a scan's cost takes milliseconds to foresee."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A region that could be scanned next, its expected error predicted, and the path that would do it."""

    region: Region
    path: Trajectory


def choose(
    candidates: Sequence[Candidate], planner: Planner, present_error: float, share: Callable[[Candidate], float]
) -> Candidate | None:
    """The best candidate that fits the budget; None when none does.

    `information`: the fastest fall of the expected error, as a logarithm, for its share of the budget: what is left
    must last until the tolerance is met. `confidence`: the proposer's order.

    Args:
        present_error: m, the estimate's expected error without another scan.
        share: what part of what is left of its scarcest budget a candidate's scan would use; above 1 it does not fit.
    """
    if planner is Planner.CONFIDENCE:
        order = sorted(candidates, key=lambda candidate: -candidate.region.confidence)
        return next((candidate for candidate in order if share(candidate) <= 1), None)
    order = sorted(candidates, key=lambda candidate: candidate.region.expected_error)
    best, best_rate = None, -np.inf
    for candidate in order[:_COMPARED]:
        part = share(candidate)
        rate = float(np.log(present_error / candidate.region.expected_error)) / part
        if part <= 1 and rate > best_rate:
            best, best_rate = candidate, rate
    return best or next((candidate for candidate in order[_COMPARED:] if share(candidate) <= 1), None)
