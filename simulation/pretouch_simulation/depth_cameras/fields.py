"""Random fields over an image, smooth on a given scale."""

from __future__ import annotations

import numpy as np

from pretouch.geometry import Array

_REACH = 3.0
"""How far outside the image the grid begins, in standard deviations of the kernel."""


def smooth_field(rng: np.random.Generator, shape: tuple[int, int], scale: float) -> Array:
    """(h, w): a Gaussian field of mean 0 and variance 1 everywhere.

    White noise on a grid `scale` wide, convolved with a Gaussian: values r px apart correlate by about
    exp(-(r / (2 scale))^2).

    Args:
        scale: px, standard deviation of the Gaussian. Below one the noise is white.
    """
    if scale < 1.0:
        return rng.standard_normal(shape)
    rows, columns = _kernels(shape[0], scale), _kernels(shape[1], scale)
    return np.asarray(rows @ rng.standard_normal((rows.shape[1], columns.shape[1])) @ columns.T, dtype=np.float64)


def _kernels(length: int, scale: float) -> Array:
    """(length, n): the weight of each grid value at each pixel, their squares adding up to one."""
    grid = np.arange(-_REACH * scale, length + _REACH * scale, scale)
    weights = np.exp(-0.5 * ((np.arange(length)[:, None] - grid) / scale) ** 2)
    return np.asarray(weights / np.linalg.norm(weights, axis=1, keepdims=True), dtype=np.float64)


def block_field(rng: np.random.Generator, shape: tuple[int, int], side: float) -> Array:
    """(h, w): white noise of variance 1, the same within squares of `side` px, at least one."""
    step = max(side, 1.0)
    v, u = ((np.arange(length) / step).astype(np.int64) for length in shape)
    return rng.standard_normal((v[-1] + 1, u[-1] + 1))[np.ix_(v, u)]
