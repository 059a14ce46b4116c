"""How many of an evaluation's sessions converged, whether rightly, and how long that took."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pretouch.session import State
from pretouch_simulation.evaluation_rows import Row, Run
from pretouch_simulation.evaluation_summary import Setup, group_by_setup

GROUND_TRUTH = 0.002
"""m: the uncertainty of a real frame's ground truth after its depth is fitted."""


@dataclass(frozen=True)
class Convergence:
    """The sessions of one setup; the members after `converged` are over those that converged, NaN if none did.

    Attributes:
        n: how many there are; failed ones are left out.
        converged: share that ended so.
        within: share whose true error was within the tolerance; on real frames `error_fitted`, and 2 mm more.
        seconds_median, seconds_p90: of the robot's time.
    """

    setup: Setup
    n: int
    converged: float
    within: float
    seconds_median: float
    seconds_p90: float


def convergence(runs: Sequence[Run], tolerance: float) -> list[Convergence]:
    """One for each setup, in the order of the runs; `tolerance` in m."""
    return [_convergence(setup, group, tolerance) for setup, group in group_by_setup(runs).items()]


def _convergence(setup: Setup, runs: Sequence[Run], tolerance: float) -> Convergence:
    ends = [run.rows[-1] for run in runs if run.rows and run.rows[-1].state == State.CONVERGED]
    seconds = np.array([row.robot_seconds for row in ends] or [np.nan])
    return Convergence(
        setup=setup,
        n=len(runs),
        converged=len(ends) / len(runs),
        within=float(np.mean([_within(row, tolerance) for row in ends])) if ends else float("nan"),
        seconds_median=float(np.median(seconds)),
        seconds_p90=float(np.quantile(seconds, 0.9)),
    )


def _within(row: Row, tolerance: float) -> bool:
    if row.error_fitted is None:
        return row.error <= tolerance
    return row.error_fitted <= tolerance + GROUND_TRUTH
