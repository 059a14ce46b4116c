"""Statistics of the rows of one setup: by object and proposer, and relative to the oracle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from experiments.one_scan import CANDIDATES, Row
from experiments.oracle import average_best, chance, compute_gap_closed, hindsight, oracle
from pretouch.geometry import Array

LARGE = 0.01
"""m."""


@dataclass(frozen=True)
class Cell:
    """One proposer on one object, all views together; m.

    Attributes:
        mean: over proposals, views and offsets.
        std_runs: of the single scans' errors, over all of them.
        std_proposals: of the proposals' errors, each averaged over the offsets.
        runs: scans.
        proposals: rectangles given, over all views.
    """

    mean: float
    std_runs: float
    std_proposals: float
    runs: int
    proposals: int


@dataclass(frozen=True)
class Overall:
    """One proposer over all objects: mean and both deviations are the means of the objects' own; m.

    Attributes:
        best_on: objects on which no other proposer's mean is lower.
        given: rectangles a view.
        pathless: share of the rectangles that cannot be scanned.
        gap, gap_hindsight: share of the gain from chance to the oracle that it achieves, and to the one with hindsight;
            NaN without candidates.
    """

    mean: float
    std_runs: float
    std_proposals: float
    median: float
    p95: float
    large: float
    runs: int
    best_on: int
    given: float
    pathless: float
    gap: float
    gap_hindsight: float


@dataclass(frozen=True)
class Ends:
    """Chance and oracle, and the registrar's own choice between them; m, means over `targets` views."""

    targets: int
    chance: float
    oracle: float
    hindsight: float
    predicted: float


def cell(rows: Sequence[Row]) -> Cell | None:
    """Of one proposer's rows on one object; None if it gave no rectangle there."""
    given = [np.array(row.errors) for row in rows if row.errors]
    if not given:
        return None
    runs = np.concatenate([errors.ravel() for errors in given])
    proposals = np.concatenate([errors.mean(axis=1) for errors in given])
    return Cell(float(runs.mean()), float(runs.std()), float(proposals.std()), len(runs), len(proposals))


def cells(rows: Sequence[Row]) -> dict[str, dict[str, Cell | None]]:
    """By object, then by proposer, both in the order of the rows."""
    proposals = [row for row in rows if row.subject != CANDIDATES]
    objects, subjects = (
        list(dict.fromkeys(names)) for names in ([r.object for r in proposals], [r.subject for r in proposals])
    )
    return {
        name: {
            subject: cell([row for row in proposals if (row.object, row.subject) == (name, subject)])
            for subject in subjects
        }
        for name in objects
    }


def ends(rows: Sequence[Row]) -> Ends | None:
    """Over the targets whose candidates were scanned; None if there are none."""
    scanned = [row for row in rows if row.subject == CANDIDATES and row.errors]
    if not scanned:
        return None
    predicted = [average_best(row.errors, row.predicted) for row in scanned if row.predicted]
    return Ends(
        targets=len(scanned),
        chance=_mean([chance(row.errors) for row in scanned]),
        oracle=_mean([oracle(row.errors) for row in scanned]),
        hindsight=_mean([hindsight(row.errors) for row in scanned]),
        predicted=_mean(predicted) if predicted else float("nan"),
    )


def overall(rows: Sequence[Row], subject: str) -> Overall | None:
    """Of the proposer `subject` among the `rows` of one setup; None if it gave no rectangle at all."""
    table = cells(rows)
    own = [found for by_subject in table.values() if (found := by_subject.get(subject)) is not None]
    if not own:
        return None
    given = [row for row in rows if row.subject == subject and not row.problem]
    runs = np.concatenate([np.ravel(row.errors) for row in given])
    gaps = _gaps(rows, [row for row in given if row.errors])
    return Overall(
        mean=_mean([one.mean for one in own]),
        std_runs=_mean([one.std_runs for one in own]),
        std_proposals=_mean([one.std_proposals for one in own]),
        median=float(np.median(runs)),
        p95=float(np.quantile(runs, 0.95)),
        large=float((runs > LARGE).mean()),
        runs=len(runs),
        best_on=sum(_best(by_subject) == subject for by_subject in table.values()),
        given=_mean([len(row.rectangles) for row in given]),
        pathless=sum(row.pathless for row in given) / max(1, sum(len(row.rectangles) for row in given)),
        gap=gaps[0],
        gap_hindsight=gaps[1],
    )


def initial(rows: Sequence[Row]) -> float:
    """m: mean error without a scan, over targets and offsets."""
    by_target: dict[str, Array] = {row.target: np.array(row.initial) for row in rows if row.initial}
    return float(np.mean(list(by_target.values())))


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


def _gaps(rows: Sequence[Row], given: Sequence[Row]) -> tuple[float, float]:
    """The share of the gain that the proposer of the rows `given` achieves, on targets with candidates."""
    targets = {row.target for row in given}
    between = ends([row for row in rows if row.target in targets])
    if between is None:
        return float("nan"), float("nan")
    scanned = {row.target for row in rows if row.subject == CANDIDATES and row.errors}
    achieved = _mean([float(np.mean(row.errors)) for row in given if row.target in scanned])
    return (
        compute_gap_closed(between.chance, achieved, between.oracle),
        compute_gap_closed(between.chance, achieved, between.hindsight),
    )


def _best(by_subject: dict[str, Cell | None]) -> str:
    means = {subject: found.mean for subject, found in by_subject.items() if found is not None}
    return min(means, key=means.__getitem__) if means else ""
