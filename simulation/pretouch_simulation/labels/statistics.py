"""Statistics of a dataset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pretouch_detector.training.dataset import SIDES, Dataset, Example
from rich.table import Table
from scipy.stats import spearmanr

from pretouch.errors import NotFound
from pretouch.estimate import from_prior
from pretouch.geometry import Array
from pretouch.prior import Prior

_SAME = 1e-3
"""Relative tolerance of a value stored in single precision against one recomputed from stored depth."""
_CM = 100.0
_LEAST = 5
"""The least number of rectangles with all their trials for which the halves are compared."""


@dataclass(frozen=True, eq=False)
class ViewStatistics:
    """The statistics of one view.

    Attributes:
        rectangles: how many.
        errors: (k,), m, ascending: of those with trials.
        unscannable: share of the rectangles along which the finger never comes over the object; NaN if that was not
            determined.
        agreement: rank correlation, over the rectangles, of the first half of the trials with the second: how far
            a score depends on the rectangle and not on the trials' randomness. NaN with fewer than two trials or five
            rectangles.
    """

    object: str
    side: str
    rectangles: int
    errors: Array
    unscannable: float
    agreement: float

    @property
    def best(self) -> float:
        return float(self.errors[0])

    @property
    def median(self) -> float:
        return float(np.median(self.errors))


def statistics_of(example: Example, side: str, worst: bool) -> ViewStatistics:
    """The statistics of a view; `worst` as in `Example.compute_errors`."""
    errors = example.compute_errors(worst)
    unscannable = np.nan
    if not np.isnan(example.predicted).all():
        left = from_prior(Prior(), example.scene.cloud).expected_error
        unscannable = float((example.predicted >= (1.0 - _SAME) * left).mean())
    known = np.sort(errors[~np.isnan(errors)])
    return ViewStatistics(example.object, side, len(example.rectangles), known, unscannable, _agreement(example, worst))


def _agreement(example: Example, worst: bool) -> float:
    half = example.scores.shape[1] // 2
    tried = example.scores[np.isfinite(example.scores).all(axis=1)]
    if half < 1 or len(tried) < _LEAST:
        return float("nan")
    first, second = ((np.max if worst else np.mean)(part, axis=1) for part in (tried[:, :half], tried[:, half:]))
    return float(spearmanr(first, second).statistic)


def statistics(dataset: Dataset) -> list[ViewStatistics]:
    """The statistics of all views.

    Raises:
        NotFound: there is none.
        Malformed: a file is damaged.
    """
    found = [
        statistics_of(example, side, dataset.by_worst) for side in SIDES for example in dataset.read_examples(side)
    ]
    if not found:
        raise NotFound(f"{dataset.folder} holds no labelled view yet.", "Go on with `pretouch labels generate`.")
    return found


def table(views: Sequence[ViewStatistics]) -> Table:
    """A column for each side; errors in cm, means over views of each view's best, median and worst rectangle."""
    shown = Table(title="labels; errors in cm")
    counts, errors = ("objects", "views", "rectangles", "with trials"), ("best", "median", "worst")
    names = (*counts, *errors, "unscannable", "halves agree")
    sides = (*SIDES, "both")
    shown.add_column("")
    for side in sides:
        shown.add_column(side, justify="right", no_wrap=True)
    columns = [_cells([view for view in views if side in (view.side, "both")]) for side in sides]
    for name, *cells in zip(names, *columns, strict=True):
        shown.add_row(name, *cells)
    return shown


def _cells(group: Sequence[ViewStatistics]) -> list[str]:
    scored = [view for view in group if len(view.errors)]
    each = [[view.best, view.median, float(view.errors[-1])] for view in scored]
    means = _CM * np.mean(each, axis=0) if scored else np.full(3, np.nan)
    return [
        f"{len({view.object for view in group})}",
        f"{len(group)}",
        f"{sum(view.rectangles for view in group)}",
        f"{sum(len(view.errors) for view in group)}",
        *("-" if np.isnan(mean) else f"{mean:.2f}" for mean in means),
        _mean([view.unscannable for view in group], "{:.1%}"),
        _mean([view.agreement for view in group], "{:.2f}"),
    ]


def _mean(values: Sequence[float], form: str) -> str:
    finite = [value for value in values if not np.isnan(value)]
    return form.format(np.mean(finite)) if finite else "-"
