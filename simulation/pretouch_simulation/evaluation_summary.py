"""Statistics of the runs of one engine, sensor and camera after a number of scans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pretouch.geometry import Array
from pretouch_simulation.evaluation_rows import Detail, Row, Run

LARGE = 0.01
"""m: an error above this counts as a failure."""


@dataclass(frozen=True)
class Setup:
    """What the runs of one summary have in common."""

    engine: str
    sensor: str
    camera: str

    @property
    def world(self) -> tuple[str, str]:
        """Camera and sensor."""
        return self.camera, self.sensor


@dataclass(frozen=True)
class Summary:
    """All runs of one setup after `scan` scans; 0 is before the first.

    A run that stopped counts with its last state, one that never scanned with its first error. Metres and seconds.

    Attributes:
        n: how many runs there are; those that failed before they had an error are left out.
        made: how many of them made this scan.
        sd: standard deviation of the errors.
        large: share of the errors above 1 cm.
        error_fitted: mean, over the runs that scanned; NaN except on real frames.
        covered: share of the runs whose truth lies in the stated 95 % region; this and what follows is NaN before the
            first scan.
        compute_p50, compute_p95: ms, over the runs that made this scan.
    """

    setup: Setup
    scan: int
    n: int
    made: int
    mean: float
    sd: float
    median: float
    p95: float
    large: float
    error_fitted: float
    covered: float
    expected_error: float
    fraction: float
    robot_seconds: float
    compute_p50: float
    compute_p95: float


def summaries(runs: Sequence[Run], scans: Sequence[int]) -> list[Summary]:
    """One for each setup, in the order of the runs, and each of `scans`."""
    return [summary_of(group, scan) for group in group_by_setup(runs).values() for scan in scans]


def group_by_setup(runs: Sequence[Run]) -> dict[Setup, list[Run]]:
    """The runs that have an error, by setup, in the order given."""
    groups: dict[Setup, list[Run]] = {}
    for run in runs:
        if run.initial_error is not None:
            groups.setdefault(Setup(run.engine, run.sensor, run.camera), []).append(run)
    return groups


def errors_after(runs: Sequence[Run], scan: int) -> Array:
    """m, (n,): each run's error after `scan`, its last one if it stopped earlier, its first if it never scanned."""
    return np.array(
        [run.rows[min(scan, len(run.rows)) - 1].error if run.rows and scan else run.initial_error for run in runs],
        dtype=np.float64,
    )


def states_after(runs: Sequence[Run], scan: int) -> list[tuple[Row, Detail]]:
    """Each run's state after `scan`, its last one if it stopped earlier; runs that never scanned have none."""
    last = [(run, min(scan, len(run.rows)) - 1) for run in runs if run.rows and scan]
    return [(run.rows[k], run.details[k]) for run, k in last]


def summary_of(runs: Sequence[Run], scan: int) -> Summary:
    """Of runs that have an error; the setup named is the first one's."""
    errors = errors_after(runs, scan)
    rows = [row for row, _ in states_after(runs, scan)]
    made = [row for row in rows if row.scan == scan]
    compute = np.array([row.compute_ms for row in made] or [np.nan], dtype=np.float64)

    def mean(field: str) -> float:
        values = [getattr(row, field) for row in rows]
        return float(np.mean([value for value in values if value is not None] or [np.nan]))

    return Summary(
        setup=Setup(runs[0].engine, runs[0].sensor, runs[0].camera),
        scan=scan,
        n=len(runs),
        made=len(made),
        mean=float(errors.mean()),
        sd=float(errors.std()),
        median=float(np.median(errors)),
        p95=float(np.quantile(errors, 0.95)),
        large=float((errors > LARGE).mean()),
        error_fitted=mean("error_fitted"),
        covered=mean("covered"),
        expected_error=mean("expected_error"),
        fraction=mean("fraction"),
        robot_seconds=mean("robot_seconds"),
        compute_p50=float(np.quantile(compute, 0.5)),
        compute_p95=float(np.quantile(compute, 0.95)),
    )
