"""Batches of labelled views, as tensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pretouch_detector.training.targets import Targets


@dataclass(frozen=True, eq=False)
class Batch:
    """`Targets` of b views with r rectangles each.

    Attributes:
        image: (b, C, S, S).
        rectangles: (b, r, 5).
        errors: (b, r, 3), m, NaN where unknown.
        analytic: (b, r), m.
    """

    image: Tensor
    rectangles: Tensor
    errors: Tensor
    analytic: Tensor


def batch_of(views: Sequence[Targets], rectangles: int, rng: np.random.Generator, device: torch.device) -> Batch:
    """The views with `rectangles` rectangles drawn from each; a view that has fewer repeats some."""
    chosen = [_draw_indices(len(view.rectangles), rectangles, rng) for view in views]
    return Batch(
        torch.from_numpy(np.stack([view.image for view in views])).to(device),
        torch.from_numpy(np.stack([view.rectangles[k] for view, k in zip(views, chosen, strict=True)])).to(device),
        torch.from_numpy(np.stack([view.errors[k] for view, k in zip(views, chosen, strict=True)])).to(device),
        torch.from_numpy(np.stack([view.analytic[k] for view, k in zip(views, chosen, strict=True)])).to(device),
    )


def _draw_indices(there: int, wanted: int, rng: np.random.Generator) -> np.ndarray:
    order = rng.permutation(there)
    return np.resize(order, wanted)
