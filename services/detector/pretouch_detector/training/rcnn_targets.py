"""Which anchors and proposals count as good, which as bad, and where the good ones should move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_detector.model.anchors import encode
from pretouch_detector.overlap import overlap
from pretouch_detector.training.targets import ACHIEVED, FORESEEN

BEST = 0.1
"""Share of an image's labelled rectangles that are best. The lower end of random candidates' errors is flat and one
trial is noisy: the single best would be best by luck, and the best tenth are all worth finding."""
GOOD, BAD = 0.5, 0.3
"""One is good if it overlaps a best rectangle by at least GOOD, bad if it overlaps all by less than BAD."""


@dataclass(frozen=True, eq=False)
class Matches:
    """What n anchors or proposals of an image should become.

    Attributes:
        good, bad: (n,) bool; those between are neither.
        deltas: (n, 6) to the best rectangle that each overlaps most; meaningless where not `good`.
    """

    good: NDArray[np.bool_]
    bad: NDArray[np.bool_]
    deltas: Array


def best_of(errors: NDArray[Any]) -> NDArray[np.intp]:
    """Which of an image's rectangles are best: indices, at least one.

    Judged by what the registrar foresees where it was asked of more rectangles than were tried, else by the trials.

    Args:
        errors: (r, 3), m, as `Targets` has them.
    """
    known = np.isfinite(errors)
    kind = FORESEEN if known[:, FORESEEN].sum() > known[:, ACHIEVED].sum() else ACHIEVED
    count = max(1, int(np.ceil(BEST * known[:, kind].sum())))
    return np.argsort(np.where(known[:, kind], errors[:, kind], np.inf), kind="stable")[:count]


def matched(rectangles: NDArray[Any], best: NDArray[Any], each_found: bool) -> Matches:
    """Compares (n, 5) with an image's best rectangles (k, 5), k >= 1.

    Args:
        each_found: what overlaps a best rectangle most is good even if by less than GOOD, so that none goes unlearned.
    """
    shared = overlap(rectangles, best)
    nearest = shared.argmax(axis=1)
    most = shared.max(axis=1)
    good = most >= GOOD
    if each_found:
        closest = shared.argmax(axis=0)
        good[closest] = True
        nearest[closest] = np.arange(len(best))
    return Matches(good, (most < BAD) & ~good, encode(rectangles, best[nearest]))
