"""What the runs of one engine and one sensor came to after so many scans, in numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pretouch.geometry import Array
from pretouch_simulation.evaluation_rows import Detail, Row, Run

LARGE = 0.01
"""m: an error above this counts as a failure."""


@dataclass(frozen=True)
class Summary:
    """All runs of one engine and one sensor after `scan` scans; 0 is before the first.

    A run that stopped counts with its last state, one that never scanned with its first error. Metres and seconds.

    Attributes:
        n: how many runs there are; those that failed before they had an error are left out.
        sd: standard deviation of the errors.
        large: share of the errors above 1 cm.
        covered: share of the runs whose truth lies in the stated 95 % region; this and what follows is NaN before the
            first scan.
        compute_p50, compute_p95: ms, over the runs that made this scan.
    """

    engine: str
    sensor: str
    scan: int
    n: int
    mean: float
    sd: float
    median: float
    p95: float
    large: float
    covered: float
    expected_error: float
    fraction: float
    robot_seconds: float
    compute_p50: float
    compute_p95: float


def summaries(runs: Sequence[Run], scans: Sequence[int]) -> list[Summary]:
    """One for each engine and sensor, in the order of the runs, and each of `scans`."""
    return [_summary(group, scan) for group in by_setup(runs).values() for scan in scans]


def by_setup(runs: Sequence[Run]) -> dict[tuple[str, str], list[Run]]:
    """The runs that have an error, by engine and sensor, in the order given."""
    groups: dict[tuple[str, str], list[Run]] = {}
    for run in runs:
        if run.initial_error is not None:
            groups.setdefault((run.engine, run.sensor), []).append(run)
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


def _summary(runs: Sequence[Run], scan: int) -> Summary:
    errors = errors_after(runs, scan)
    rows = [row for row, _ in states_after(runs, scan)]
    compute = np.array([row.compute_ms for row in rows if row.scan == scan] or [np.nan], dtype=np.float64)

    def mean(field: str) -> float:
        return float(np.mean([getattr(row, field) for row in rows])) if rows else float("nan")

    return Summary(
        engine=runs[0].engine,
        sensor=runs[0].sensor,
        scan=scan,
        n=len(runs),
        mean=float(errors.mean()),
        sd=float(errors.std()),
        median=float(np.median(errors)),
        p95=float(np.quantile(errors, 0.95)),
        large=float((errors > LARGE).mean()),
        covered=mean("covered"),
        expected_error=mean("expected_error"),
        fraction=mean("fraction"),
        robot_seconds=mean("robot_seconds"),
        compute_p50=float(np.quantile(compute, 0.5)),
        compute_p95=float(np.quantile(compute, 0.95)),
    )
