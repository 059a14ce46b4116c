"""How many of an evaluation's sessions converged, after how many scans, whether rightly, and how long that took."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pretouch.session import State
from pretouch.trajectory import APPROACH_SECONDS
from pretouch_simulation.evaluation_rows import Run
from pretouch_simulation.evaluation_summary import Setup, group_by_setup

GROUND_TRUTH = 0.002
"""m: the uncertainty of a real frame's ground truth after its depth is fitted."""


@dataclass(frozen=True)
class Convergence:
    """The sessions of one setup.

    Attributes:
        n: how many there are; failed ones are left out.
        converged: share that ended so.
        converged_after: share that had after 1, 2, ... scans, as many as any session made.
        first_returns: median, over the sessions that scanned, of the share of the first scan's samples that returned;
            NaN where scans are points.
        within: share whose true error was within the tolerance; on real frames `error_fitted`, and 2 mm more. This and
            what follows is over the sessions that converged, NaN if none did.
        seconds_median, seconds_p90: of the robot's time, the sum of the scans' durations.
        approached_median, approached_p90: of the same with APPROACH_SECONDS for each scan.
    """

    setup: Setup
    n: int
    converged: float
    converged_after: tuple[float, ...]
    first_returns: float
    within: float
    seconds_median: float
    seconds_p90: float
    approached_median: float
    approached_p90: float


def convergence(runs: Sequence[Run], tolerance: float) -> list[Convergence]:
    """One for each setup, in the order of the runs; `tolerance` in m."""
    return [_convergence(setup, group, tolerance) for setup, group in group_by_setup(runs).items()]


def _convergence(setup: Setup, runs: Sequence[Run], tolerance: float) -> Convergence:
    ends = [run.rows[-1] for run in runs if run.rows and run.rows[-1].state == State.CONVERGED]
    seconds = np.array([row.robot_seconds for row in ends] or [np.nan])
    approached = np.array([add_approaches(row.robot_seconds, row.scan) for row in ends] or [np.nan])
    within = [is_within(row.error, row.error_fitted, tolerance) for row in ends]
    most = max(len(run.rows) for run in runs)
    returns = [run.rows[0].returns for run in runs if run.rows]
    return Convergence(
        setup=setup,
        n=len(runs),
        converged=len(ends) / len(runs),
        converged_after=tuple(sum(row.scan <= scan for row in ends) / len(runs) for scan in range(1, most + 1)),
        first_returns=float(np.median([share for share in returns if share is not None] or [np.nan])),
        within=float(np.mean(within)) if within else float("nan"),
        seconds_median=float(np.median(seconds)),
        seconds_p90=float(np.quantile(seconds, 0.9)),
        approached_median=float(np.median(approached)),
        approached_p90=float(np.quantile(approached, 0.9)),
    )


def add_approaches(robot_seconds: float, scans: int) -> float:
    """s: what `scans` whose durations sum to `robot_seconds` cost the robot with the way to each."""
    return robot_seconds + APPROACH_SECONDS * scans


def is_within(error: float, error_fitted: float | None, tolerance: float) -> bool:
    """Whether a true error is within the tolerance: `error`, or where there is one `error_fitted`, and 2 mm more; m."""
    return error <= tolerance if error_fitted is None else error_fitted <= tolerance + GROUND_TRUTH
