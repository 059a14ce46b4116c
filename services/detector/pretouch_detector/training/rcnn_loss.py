"""What the two-stage design is taught by."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from pretouch.geometry import Array
from pretouch_detector.model.anchors import anchors, decode, quarter_turned
from pretouch_detector.model.rcnn import RotatedRCNN
from pretouch_detector.training.batch import Batch
from pretouch_detector.training.error_terms import error_terms
from pretouch_detector.training.rcnn_targets import Matches, best_of, matched

_ANCHORS = anchors()
_SAMPLED = 64
"""Anchors of an image that teach the first stage, half of them good if there are so many."""
_PROMISING, _PROPOSALS = 128, 32
"""Of an image: of so many of the first stage's best, so many go into the second; neighbours are much alike."""
_BETA = 0.1
"""Where the loss of a delta turns from square to straight."""


def rcnn_loss(model: RotatedRCNN, batch: Batch) -> dict[str, Tensor]:
    """The terms of the loss, by name: objectness and deltas of both stages, and the errors as for the scorer.

    The second stage is shown all labelled rectangles and the first stage's best proposals, each told in one of its two
    ways by chance. Only the labelled ones teach errors; only proposals teach to move.
    """
    features = model.features(batch.image)
    objectness, deltas = model.rpn(features)
    labelled = batch.rectangles.cpu().numpy().astype(np.float64)
    best = [best_of(errors) for errors in batch.errors.cpu().numpy()]
    wanted = [rectangles[which] for rectangles, which in zip(labelled, best, strict=True)]
    anchored = [matched(_ANCHORS, rectangles, each_found=True) for rectangles in wanted]

    proposed = _proposed(objectness, deltas)
    shown = np.stack([_told_either_way(each) for each in np.concatenate([labelled, proposed], axis=1)])
    score, moves, errors = model.head(features, torch.from_numpy(shown.astype(np.float32)).to(features.device))
    r = labelled.shape[1]
    found = [matched(rectangles[r:], each, each_found=False) for rectangles, each in zip(shown, wanted, strict=True)]
    return {
        "objectness": _objectness(objectness, anchored, _drawn(anchored)),
        "anchor deltas": _moves(deltas, anchored),
        "score": _objectness(score, [_with_labelled(r, k, each) for k, each in zip(best, found, strict=True)]),
        "deltas": _moves(moves[:, r:], found),
        **error_terms(errors[:, :r], batch.errors),
    }


def _proposed(objectness: Tensor, deltas: Tensor) -> Array:
    """(b, _PROPOSALS, 5): some of the most promising anchors, moved."""
    chosen = objectness.topk(_PROMISING, dim=1).indices[
        :, torch.randperm(_PROMISING)[:_PROPOSALS].to(objectness.device)
    ]
    moved = deltas.detach().gather(1, chosen[..., None].expand(-1, -1, 6)).cpu().numpy()
    return np.stack([decode(_ANCHORS[k], each) for k, each in zip(chosen.cpu().numpy(), moved, strict=True)])


def _told_either_way(rectangles: Array) -> Array:
    return quarter_turned(rectangles, np.asarray(torch.rand(len(rectangles)).numpy() < 0.5))


def _with_labelled(labelled: int, best: NDArray[np.intp], proposals: Matches) -> Matches:
    """A labelled rectangle is good if it is one of the best itself: near one, but worse, is what must be told apart."""
    good = np.isin(np.arange(labelled), best)
    none = np.zeros((labelled, 6))
    return Matches(
        np.concatenate([good, proposals.good]),
        np.concatenate([~good, proposals.bad]),
        np.concatenate([none, proposals.deltas]),
    )


def _drawn(matches: list[Matches]) -> NDArray[np.bool_]:
    """(b, A): anchors that teach, at most half of an image's good ones."""
    drawn = np.zeros((len(matches), len(_ANCHORS)), dtype=bool)
    for row, each in zip(drawn, matches, strict=True):
        good = _some(np.flatnonzero(each.good), _SAMPLED // 2)
        row[good] = True
        row[_some(np.flatnonzero(each.bad), _SAMPLED - len(good))] = True
    return drawn


def _some(indices: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    return indices[torch.randperm(len(indices)).numpy()[:count]]


def _objectness(logits: Tensor, matches: list[Matches], drawn: NDArray[np.bool_] | None = None) -> Tensor:
    """Mean cross entropy, logits (b, n), over those that are good or bad, and drawn."""
    good = np.stack([each.good for each in matches])
    counted = good | np.stack([each.bad for each in matches])
    where = _on(logits, counted if drawn is None else counted & drawn)
    return functional.binary_cross_entropy_with_logits(logits[where], _on(logits, good)[where].to(logits.dtype))


def _moves(deltas: Tensor, matches: list[Matches]) -> Tensor:
    """Mean smooth L1 distance of the good ones' deltas, (b, n, 6); 0 where there is none."""
    where = _on(deltas, np.stack([each.good for each in matches]))
    goals = _on(deltas, np.stack([each.deltas for each in matches]).astype(np.float32))
    summed = functional.smooth_l1_loss(deltas[where], goals[where], beta=_BETA, reduction="sum")
    return summed / where.sum().clamp_min(1)


def _on(like: Tensor, array: NDArray[Any]) -> Tensor:
    return torch.from_numpy(array).to(like.device)
