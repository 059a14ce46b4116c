"""How both designs are taught the errors of rectangles."""

from __future__ import annotations

import torch
from torch import Tensor

from pretouch_detector.training.targets import ACHIEVED, EXPECTED, FORESEEN

_SHARPNESS = 3.0
"""Of the two helping terms: an error of a third in a prediction costs about as much as the achieved error's noise."""


def error_terms(out: Tensor, errors: Tensor) -> dict[str, Tensor]:
    """Terms of the loss, by name.

    `achieved` is the negative log likelihood of an exponential distribution, which has the mean error, and nothing else
    of its noisy distribution, as its optimum. `spread` is that of the logarithm's standard deviation.

    Args:
        out: (b, r, len(OUTPUTS)), as the scorer has them.
        errors: (b, r, 3), m, as `Batch` has them, NaN where unknown.
    """
    achieved, known = _known(errors[..., ACHIEVED])
    mean = out[..., 0]
    expected, told = _known(errors[..., EXPECTED])
    foreseen, asked = _known(errors[..., FORESEEN])
    apart = torch.log(achieved) - mean.detach()
    return {
        "achieved": _mean(mean + achieved * torch.exp(-mean), known),
        "spread": 0.2 * _mean(out[..., 1] + 0.5 * apart**2 * torch.exp(-2.0 * out[..., 1]), known),
        "expected": _SHARPNESS * _mean((torch.log(expected) - out[..., 2]) ** 2, told),
        "foreseen": _SHARPNESS * _mean((torch.log(foreseen) - out[..., 3]) ** 2, asked),
    }


def _known(errors: Tensor) -> tuple[Tensor, Tensor]:
    """Errors (b, r), m, with 1 in place of NaN, and where they are known."""
    known = ~torch.isnan(errors)
    return torch.where(known, errors, torch.ones_like(errors)).clamp_min(1e-5), known


def _mean(values: Tensor, where: Tensor) -> Tensor:
    return torch.where(where, values, torch.zeros_like(values)).sum() / where.sum().clamp_min(1)
