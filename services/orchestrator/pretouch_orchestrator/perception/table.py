"""The table: found in a depth image when the client does not give it, and the frame that it defines."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pretouch.estimate import Estimate
from pretouch.geometry import Array, Plane, Pose

_HYPOTHESES = 600
_VOTERS = 2500
_FITTED = 40_000
_REFINEMENTS = 4
_MIN_POINTS = 200
_MIN_SHARE = 0.2
"""A plane that fewer of the points lie on is no table."""


def depth_std(z: ArrayLike) -> Array:
    """Axial noise, m, of a Kinect-class camera at depths z, m (Nguyen, Izadi, Lovell, 3DIMPVT 2012)."""
    return np.asarray(0.0012 + 0.0019 * (np.asarray(z, dtype=np.float64) - 0.4) ** 2, dtype=np.float64)


def height_std(points: Array, normal: Array) -> Array:
    """m, (...,): what the axial noise of points (..., 3), camera frame, makes of their height along `normal`."""
    z = points[..., 2]
    return np.asarray(depth_std(z) * np.abs(points @ normal) / np.maximum(z, 1e-6) + 1e-4, dtype=np.float64)


def table_covariance(base_T_table: Pose, estimate: Estimate) -> Array:
    """The estimate's covariance 6x6 in the axes of the table as presently corrected; `base_T_table` before that."""
    turn = (estimate.base_T_correction.rotation @ base_T_table.rotation).T
    both = np.kron(np.eye(2), turn)
    return np.asarray(both @ estimate.covariance @ both.T, dtype=np.float64)


def fit_table(points: Array, below_weight: float) -> Plane | None:
    """The plane that most points lie on, its normal towards the camera.

    Consensus of planes through three points each, then weighted least squares over the winner's inliers. The same
    points give the same plane.

    Args:
        points: (n, 3), m, in the camera frame, z > 0.
        below_weight: how many inliers one point beneath the plane outweighs. A table has nothing beneath it in a view
            of its middle, and an object's top does; in a view beyond its edges there is the floor.

    Returns:
        The plane in the camera frame; None when no plane holds a fair share of the points.
    """
    if len(points) < _MIN_POINTS:
        return None
    voters = points[:: max(1, len(points) // _VOTERS)]
    corners = voters[np.random.default_rng(0).integers(len(voters), size=(_HYPOTHESES, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volumes = (normals * corners[:, 0]).sum(axis=1)
    sound = np.abs(volumes) > 1e-9
    if not sound.any():
        return None
    normals = -normals[sound] * (np.sign(volumes[sound]) / np.linalg.norm(normals[sound], axis=1))[:, None]
    offsets = (normals * corners[sound, 0]).sum(axis=1)
    along = normals @ voters.T
    heights = along - offsets[:, None]
    noise = 3 * (depth_std(voters[:, 2]) / voters[:, 2]) * np.abs(along) + 1e-3
    score = (np.abs(heights) < noise).sum(axis=1) - below_weight * (heights < -2 * noise).sum(axis=1)
    best = int(np.argmax(score))
    return _refined(points, Plane(normals[best], float(offsets[best])))


def _refined(points: Array, plane: Plane) -> Plane | None:
    fitted = points[:: max(1, len(points) // _FITTED)]
    inliers: NDArray[np.bool_] = np.zeros(len(fitted), dtype=bool)
    for _ in range(_REFINEMENTS):
        noise = height_std(fitted, plane.normal)
        inliers = np.abs(plane.height(fitted)) < 3 * noise + 1e-3
        if inliers.sum() < 3:
            return None
        weight = noise[inliers] ** -2
        centre = np.average(fitted[inliers], axis=0, weights=weight)
        arms = (fitted[inliers] - centre) * np.sqrt(weight)[:, None]
        normal = np.linalg.eigh(arms.T @ arms)[1][:, 0]
        normal *= -np.sign(normal @ centre) or 1.0
        plane = Plane(normal, float(normal @ centre))
    return plane if inliers.mean() >= _MIN_SHARE else None
