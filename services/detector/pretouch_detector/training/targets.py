"""A labelled view as the network's training data: image, rectangles, and the errors known of each rectangle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pretouch.errors import InvalidInput
from pretouch_detector.model.encoding import encode
from pretouch_detector.proposals.information import predict_errors_after_scans
from pretouch_detector.training.dataset import Dataset, Example

Floats = NDArray[np.float32]
ACHIEVED, EXPECTED, PREDICTED = range(3)


@dataclass(frozen=True, eq=False)
class Targets:
    """A labelled view, ready for training.

    Attributes:
        image: (C, S, S), see `encoding`.
        rectangles: (r, 5), as `Encoding.normalise`.
        analytic: (r,), m: as proposer `stability` computes it, see `proposals.information`.
        errors: (r, 3), m: ACHIEVED, the mean over the trials, or the worst of the paper's trials; EXPECTED by the
            engine after them; PREDICTED by the registrar before them. NaN where unknown.
    """

    image: Floats
    rectangles: Floats
    analytic: Floats
    errors: Floats


def targets_of(example: Example, worst: bool) -> Targets:
    """The training data of one view.

    Args:
        worst: take a rectangle's worst trial, as in the paper, instead of the mean of its trials.
    """
    encoding = encode(example.scene)
    expected = np.full(len(example.rectangles), np.nan)
    answered = ~np.isnan(example.expected).all(axis=1)
    expected[answered] = np.nanmean(example.expected[answered], axis=1)
    errors = np.column_stack([example.compute_errors(worst), expected, example.predicted]).astype(np.float32)
    analytic, _ = predict_errors_after_scans(example.scene, example.sensor, example.rectangles)
    return Targets(encoding.image, encoding.normalise(example.rectangles), analytic.astype(np.float32), errors)


def load(folders: Sequence[Path], side: str) -> list[Targets]:
    """All views of one side of the datasets.

    Raises:
        InvalidInput: there is none.
    """
    found = []
    for folder in folders:
        dataset = Dataset(folder)
        found += [targets_of(example, dataset.by_worst) for example in dataset.read_examples(side)]
    if not found:
        raise InvalidInput(
            f"There is no view on the side {side} of {', '.join(map(str, folders))}.", "Make more labels."
        )
    return found
