"""Which region to scan next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pretouch.session import Planner, Region
from pretouch.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Candidate:
    """A region that could be scanned next, its expected error predicted.

    Attributes:
        path: the path that would do it.
        share: what part of what is left of its scarcest budget it would use, at most 1.
    """

    region: Region
    path: Trajectory
    share: float


def choose(candidates: Sequence[Candidate], planner: Planner, present_error: float) -> Candidate | None:
    """The best candidate; None when there is none.

    `information`: the fastest fall of the expected error, as a logarithm, for its share of the budget: what is left
    must last until the tolerance is met. `confidence`: the proposer's order.

    Args:
        present_error: m, the estimate's expected error without another scan.
    """
    if planner is Planner.CONFIDENCE:
        return max(candidates, key=lambda candidate: candidate.region.confidence, default=None)
    return max(
        candidates,
        key=lambda candidate: float(np.log(present_error / candidate.region.expected_error)) / candidate.share,
        default=None,
    )
