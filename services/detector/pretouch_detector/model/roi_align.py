"""Features of rotated rectangles, on a grid of bins in each one's own axes."""

from __future__ import annotations

import torch
from torch import Tensor, nn

BINS = 7
"""In each direction. The outermost ones are centred on the perimeter, where the finger runs."""
_SAMPLES = 2
"""Of a bin, in each direction."""


def roi_align(features: Tensor, rectangles: Tensor) -> Tensor:
    """Mean of bilinear samples in each bin; beyond the image features are 0.

    Args:
        features: (b, c, s, s), covering [-1, 1] in both axes.
        rectangles: (b, r, 5) as [x, y, w, h, theta] in the same units.

    Returns:
        (b, r, c, BINS, BINS): rows along h, columns along w.
    """
    points = sample_points(rectangles)
    sampled = nn.functional.grid_sample(features, points, mode="bilinear", padding_mode="zeros", align_corners=False)
    binned = nn.functional.avg_pool2d(sampled, _SAMPLES)
    return binned.reshape(features.shape[0], features.shape[1], -1, BINS, BINS).transpose(1, 2)


def sample_points(rectangles: Tensor) -> Tensor:
    """Where features are read: (b, r * BINS * 2, BINS * 2, 2) of rectangles (b, r, 5)."""
    n = BINS * _SAMPLES
    steps = (torch.arange(n, dtype=rectangles.dtype, device=rectangles.device) - (n - 1) / 2) / (_SAMPLES * (BINS - 1))
    x, y, w, h, theta = rectangles[..., None, None].unbind(2)
    c, s = torch.cos(theta), torch.sin(theta)
    along, across = w * steps, h * steps[:, None]
    points = torch.stack([x + c * along - s * across, y + s * along + c * across], dim=-1)
    return points.reshape(rectangles.shape[0], -1, n, 2)
