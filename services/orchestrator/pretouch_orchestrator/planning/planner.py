"""Chooses the region to scan next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pretouch.session import Planner, Region
from pretouch.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Candidate:
    """A region that could be scanned next, with its predicted expected error.

    Attributes:
        path: the path of its scan.
        share: what the scan would use of what is left of its scarcest budget, at most 1.
    """

    region: Region
    path: Trajectory
    share: float


def choose(candidates: Sequence[Candidate], planner: Planner, present_error: float) -> Candidate | None:
    """The best candidate; None when there is none.

    `information` maximises the predicted decrease of the log expected error per share of the remaining budget.
    `confidence` follows the proposer's own scores.

    Args:
        present_error: m, the present estimate's expected error.
    """
    if planner is Planner.CONFIDENCE:
        return max(candidates, key=lambda candidate: candidate.region.confidence, default=None)
    return max(
        candidates,
        key=lambda candidate: float(np.log(present_error / candidate.region.expected_error)) / candidate.share,
        default=None,
    )
