"""Measures the noise of a depth image on the table that it shows.

The errors of a depth camera have two parts: one independent for each pixel, and one common to whole patches of a
surface, since cameras match image windows and drift. Only the second part matters for a pose, because averaging over
pixels does not reduce it. Since the table is flat, the image itself shows how large both are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from pretouch.geometry import Array
from pretouch.scene import Scene

PATCH = 0.015
"""m: side of a patch of surface over which a camera's error is about constant."""
UNKNOWN_PATCH, UNKNOWN_PIXEL = 0.002, 0.003
"""m: assumed where too little of the table is seen; about that of real structured-light cameras."""
_LEAST, _MOST = 0.0002, 0.004
"""m: bounds of the patches' standard deviation."""
_BAND = 0.012
"""m from the given plane within which a pixel shows the table."""
_MARGIN = 6
"""px to everything else."""
_SCALE = 0.004
"""m: residual at which a pixel counts half in the plane fit."""
_ROUNDS = 5
_FEWEST_PIXELS, _FEWEST_PATCHES = 300, 12
_STD_PER_MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


class CameraNoise(NamedTuple):
    """Standard deviations, m, along the table's normal.

    Attributes:
        pixel: of a single pixel's depth.
        patch: of the mean of a PATCH.
    """

    pixel: float
    patch: float


def measure_camera_noise(scene: Scene) -> CameraNoise:
    """Measures it on the scene's table after a robust plane fit; a default where too little of the table is seen."""
    points = _select_table_points(scene)
    if len(points) < _FEWEST_PIXELS:
        return CameraNoise(UNKNOWN_PIXEL, UNKNOWN_PATCH)
    try:
        residuals = _fit_plane(points)
    except np.linalg.LinAlgError:  # all on one line
        return CameraNoise(UNKNOWN_PIXEL, UNKNOWN_PATCH)
    cells = np.floor(points[:, :2] / PATCH).astype(np.int64)
    _, patch = np.unique(cells[:, 0] * (np.ptp(cells[:, 1]) + 1) + cells[:, 1], return_inverse=True)
    sums, counts = np.bincount(patch, residuals), np.bincount(patch)
    there = counts >= 0.5 * np.median(counts[counts > 0])
    means = sums[there] / counts[there]
    if len(means) < _FEWEST_PATCHES:
        return CameraNoise(UNKNOWN_PIXEL, UNKNOWN_PATCH)
    return CameraNoise(_compute_robust_std(residuals), float(np.clip(_compute_robust_std(means), _LEAST, _MOST)))


def _select_table_points(scene: Scene) -> Array:
    """(n, 3), m, in the table's axes: pixels of the table, away from everything that stands on it."""
    seen = scene.depth.metres > 0
    height = scene.table.height(scene.organised)
    things = scene.mask | (seen & (height > _BAND))
    free = seen & (np.abs(height) < _BAND) & ~ndimage.binary_dilation(things, iterations=_MARGIN)
    return np.asarray(scene.organised[free] @ scene.table.frame().rotation, dtype=np.float64)


def _fit_plane(points: Array) -> Array:
    """(n,), m: the heights of points (n, 3), z upwards, above their robustly fitted plane."""
    design = np.column_stack([points[:, :2] - points[:, :2].mean(axis=0), np.ones(len(points))])
    weight = np.ones(len(points))
    for _ in range(_ROUNDS):
        weighted = design * weight[:, None]
        plane = np.linalg.solve(weighted.T @ design, weighted.T @ points[:, 2])
        residuals = points[:, 2] - design @ plane
        weight = 1.0 / (1.0 + (residuals / _SCALE) ** 2)
    return np.asarray(residuals, dtype=np.float64)


def _compute_robust_std(values: Array) -> float:
    return float(_STD_PER_MAD * np.median(np.abs(values - np.median(values))))
