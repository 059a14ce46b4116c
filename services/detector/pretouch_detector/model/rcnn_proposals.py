"""The two-stage design at work, on numpy arrays, whoever runs the two graphs: torch or onnxruntime."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_detector.model.anchors import anchors, decode
from pretouch_detector.spread import spread

Head = Callable[[NDArray[np.float32]], tuple[NDArray[Any], NDArray[Any], NDArray[Any]]]
"""Rectangles (n, 5) -> score (n,), deltas (n, 6), log_error (n, 2): the second stage of one image."""
Allowed = Callable[[Array], NDArray[np.bool_]]
"""Rectangles (n, 5) -> (n,): which may be proposed."""

_ANCHORS = anchors()
_CHUNK = 1024
"""So many of the first stage's rectangles are looked at, the best first, before it is seen whether more are needed."""
_SHRUNK = (1.0, 0.7, 0.5, 0.35)
"""Where too few are allowed, as on a slim object, smaller ones at their places are tried."""
_RIVALS, _RIVALS_EACH = 160, 8
"""Of those that are allowed, so many are compared with each other; where many are wanted, so many for each."""
_PROPOSALS, _PROPOSALS_EACH = 48, 2
"""At most so many that differ go into the second stage; where many are wanted, so many for each."""
_SAME = 0.7
"""Of the first stage's rectangles that overlap by more, intersection over union, only the better is looked at."""
APART = 0.6
"""Likewise of what is answered."""


def propose(
    objectness: NDArray[Any], deltas: NDArray[Any], head: Head, allowed: Allowed, count: int
) -> tuple[Array, Array]:
    """The best rectangles of an image by their foretold errors, and those errors.

    The second stage is asked twice: of the first stage's proposals, and of what it makes of them, since an error
    belongs to a rectangle and not to what that was moved from. Both then compete.

    Args:
        objectness, deltas: (A,) and (A, 6), the first stage's.
        count: the most that are wanted; fewer if less differ.

    Returns:
        Rectangles (k, 5) as `Encoding.normalised`, the best first, none overlapping a better one by more than APART;
        the mean errors (k,), m, that scans of their perimeters would leave.
    """
    rectangles = _first_stage(objectness, deltas, allowed, count)
    if not len(rectangles):
        return np.zeros((0, 5)), np.zeros(0)
    _, moves, logs = head(rectangles.astype(np.float32))
    moved = decode(rectangles, moves)
    moved = moved[allowed(moved)]
    if len(moved):
        logs = np.concatenate([logs, head(moved.astype(np.float32))[2]])
        rectangles = np.concatenate([rectangles, moved])
    errors = np.exp(logs[:, 0].astype(np.float64))
    order = np.argsort(errors, kind="stable")
    kept = order[spread(rectangles[order], count, APART)]
    return rectangles[kept], errors[kept]


def _first_stage(objectness: NDArray[Any], deltas: NDArray[Any], allowed: Allowed, count: int) -> Array:
    """(k, 5): the best that differ, of those that may be proposed."""
    order = np.argsort(-objectness, kind="stable")
    wanted = max(_RIVALS, _RIVALS_EACH * count)
    rivals = np.zeros((0, 5))
    for scale, start in itertools.product(_SHRUNK, range(0, len(order), _CHUNK)):
        chunk = order[start : start + _CHUNK]
        rectangles = decode(_ANCHORS[chunk], deltas[chunk]) * (1.0, 1.0, scale, scale, 1.0)
        rivals = np.concatenate([rivals, rectangles[allowed(rectangles)]])
        if len(rivals) >= wanted:
            break
    rivals = rivals[:wanted]
    return rivals[spread(rivals, max(_PROPOSALS, _PROPOSALS_EACH * count), _SAME)]
