"""The loss of the network."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from pretouch_detector.training.batch import Batch
from pretouch_detector.training.targets import ACHIEVED, EXPECTED, PREDICTED

_SHARPNESS = 3.0
"""Weight of the two auxiliary terms: a relative error of a third costs as much as the noise of the achieved error."""


def compute_loss(model: nn.Module, batch: Batch) -> dict[str, Tensor]:
    """Terms of the loss of a `Scorer`, by name.

    `achieved` is the negative log likelihood of an exponential distribution, whose optimum depends on the mean error
    alone. `spread` is that of a normal distribution of the error's logarithm. `expected` and `foreseen` (the
    registrar's prediction) are squared differences of logarithms.
    """
    out = model(batch.image, batch.rectangles, batch.analytic)
    achieved, known = _mask_unknown(batch.errors[..., ACHIEVED])
    mean = out[..., 0]
    expected, has_expected = _mask_unknown(batch.errors[..., EXPECTED])
    predicted, has_predicted = _mask_unknown(batch.errors[..., PREDICTED])
    apart = torch.log(achieved) - mean.detach()
    return {
        "achieved": _average_where(mean + achieved * torch.exp(-mean), known),
        "spread": 0.2 * _average_where(out[..., 1] + 0.5 * apart**2 * torch.exp(-2.0 * out[..., 1]), known),
        "expected": _SHARPNESS * _average_where((torch.log(expected) - out[..., 2]) ** 2, has_expected),
        "foreseen": _SHARPNESS * _average_where((torch.log(predicted) - out[..., 3]) ** 2, has_predicted),
    }


def _mask_unknown(errors: Tensor) -> tuple[Tensor, Tensor]:
    """Errors (b, r), m, with 1 in place of NaN, and where they are known."""
    known = ~torch.isnan(errors)
    return torch.where(known, errors, torch.ones_like(errors)).clamp_min(1e-5), known


def _average_where(values: Tensor, where: Tensor) -> Tensor:
    return torch.where(where, values, torch.zeros_like(values)).sum() / where.sum().clamp_min(1)
