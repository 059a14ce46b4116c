"""Whether an evaluation's estimates are calibrated: how often the truth lies in the stated regions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pretouch_simulation.evaluation_rows import Run
from pretouch_simulation.evaluation_summary import Setup, group_by_setup, states_after

CHI2_6 = (5.348, 8.558, 12.592)
"""The 50, 80 and 95 % quantiles of chi-square with 6 degrees of freedom."""
WRONG, SURE = 0.015, 0.005
"""m: an estimate is wrong with a true error above the one, and sure if it expects less than the other."""
_HARDEST = 0.25


@dataclass(frozen=True)
class Honesty:
    """The runs of one setup after `scan` scans, each with its last state if it stopped; those without a scan left out.

    Attributes:
        n: how many runs there are.
        within50, within80, within95: share of them whose truth lies in the stated region of that probability.
        hard50, hard80, hard95: the same of the quarter with the largest true errors.
        expected_error, error: m, means: stated and true.
        sure_and_wrong: share whose error is above 1.5 cm while less than 0.5 cm is expected.
    """

    setup: Setup
    scan: int
    n: int
    within50: float
    within80: float
    within95: float
    hard50: float
    hard80: float
    hard95: float
    expected_error: float
    error: float
    sure_and_wrong: float


def honesty(runs: Sequence[Run], scans: Sequence[int]) -> list[Honesty]:
    """One for each setup, in the order of the runs, and each of `scans` that any run has come to."""
    found = [_honesty(setup, group, scan) for setup, group in group_by_setup(runs).items() for scan in scans]
    return [one for one in found if one is not None]


def _honesty(setup: Setup, runs: Sequence[Run], scan: int) -> Honesty | None:
    states = states_after(runs, scan)
    if not states:
        return None
    error = np.array([row.error for row, _ in states])
    expected = np.array([row.expected_error for row, _ in states])
    distance2 = np.array([detail.distance2 for _, detail in states])
    hardest = np.argsort(-error, kind="stable")[: int(np.ceil(_HARDEST * len(states)))]
    within, hard = ([float((chosen <= limit).mean()) for limit in CHI2_6] for chosen in (distance2, distance2[hardest]))
    return Honesty(
        setup=setup,
        scan=scan,
        n=len(states),
        within50=within[0],
        within80=within[1],
        within95=within[2],
        hard50=hard[0],
        hard80=hard[1],
        hard95=hard[2],
        expected_error=float(expected.mean()),
        error=float(error.mean()),
        sure_and_wrong=float(((error > WRONG) & (expected < SURE)).mean()),
    )
