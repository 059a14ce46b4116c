"""The beams' information about a pose, as a layer: the posterior variances, from the calibration prior."""

from __future__ import annotations

import torch
from torch import Tensor

from pretouch_detector.model.encoding import CHANNELS, LENGTH

_PRIOR = (0.05, 0.05, 0.05, 0.0115 / LENGTH, 0.0115 / LENGTH, 0.0115 / LENGTH)
"""Standard deviations of rotation vector, rad, and translation, in LENGTH, as of `Prior`."""
_PLACES = slice(0, 3)
_OBJECT = CHANNELS.index("object")


def locate_object(image: Tensor) -> tuple[Tensor, Tensor]:
    """The object's mean (b, 3), as height, away and across, and rms radius (b,), in LENGTH, of images (b, C, s, s)."""
    on = (image[:, _OBJECT] > 0.5).to(image.dtype)
    share = on / on.sum(dim=(1, 2), keepdim=True).clamp_min(1.0)
    places = image[:, _PLACES]
    middle = (places * share[:, None]).sum(dim=(2, 3))
    squares = ((places - middle[:, :, None, None]) ** 2 * share[:, None]).sum(dim=(1, 2, 3))
    return middle, torch.sqrt(squares + 1e-6)


def predict_variances(arms: Tensor, directions: Tensor) -> Tensor:
    """Variances (..., 6) of rotation vector, rad^2, and translation, LENGTH^2, after the beams, given the prior.

    Args:
        arms: (..., 1, p, 3), LENGTH, from the object's middle to where each beam ends.
        directions: (..., k, p, 3), 1 / LENGTH, along which the k measurements of each beam constrain that place: unit
            vectors divided by their standard deviations.
    """
    a, d = arms, directions
    turns = torch.stack(
        [
            a[..., 1] * d[..., 2] - a[..., 2] * d[..., 1],
            a[..., 2] * d[..., 0] - a[..., 0] * d[..., 2],
            a[..., 0] * d[..., 1] - a[..., 1] * d[..., 0],
        ],
        dim=-1,
    )
    prior = d.new_tensor(_PRIOR)
    rows = (torch.cat([turns, d], dim=-1) * prior).flatten(-3, -2)  # (..., k p, 6)
    information = rows.transpose(-1, -2) @ rows + torch.eye(6, dtype=d.dtype, device=d.device)
    return torch.diagonal(invert(information), dim1=-2, dim2=-1) * prior**2


def invert(matrix: Tensor) -> Tensor:
    """Inverts symmetric positive definite matrices (..., n, n) by Gauss-Jordan: ONNX has no operator for it."""
    n = matrix.shape[-1]
    eye = torch.eye(n, dtype=matrix.dtype, device=matrix.device)
    work = torch.cat([matrix, eye.expand_as(matrix)], dim=-1)
    for k in range(n):
        pivot = work[..., k : k + 1, :] / work[..., k : k + 1, k : k + 1]
        work = work - work[..., :, k : k + 1] * pivot + eye[:, k : k + 1] * pivot
    return work[..., n:]
