"""Fits the table to a depth image, and expresses the noise and the estimate's covariance in terms of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pretouch.camera import kinect_depth_std
from pretouch.estimate import Estimate
from pretouch.geometry import Array, Plane, Pose

_HYPOTHESES = 600
_MAX_SCORED = 2500
_MAX_FITTED = 40_000
_REFINEMENTS = 4
_MIN_POINTS = 200
_MIN_SHARE = 0.2
"""Least share of the points that lie on a table."""


def height_std(points: Array, normal: Array) -> Array:
    """m, (...,): standard deviation, by axial noise, of the height along `normal` of points (..., 3), camera frame."""
    z = points[..., 2]
    return np.asarray(kinect_depth_std(z) * np.abs(points @ normal) / np.maximum(z, 1e-6) + 1e-4, dtype=np.float64)


def table_covariance(base_T_table: Pose, estimate: Estimate) -> Array:
    """The estimate's 6x6 covariance in the axes of the corrected table; `base_T_table` is the uncorrected one."""
    turn = (estimate.base_T_correction.rotation @ base_T_table.rotation).T
    both = np.kron(np.eye(2), turn)
    return np.asarray(both @ estimate.covariance @ both.T, dtype=np.float64)


def fit_table(points: Array, below_weight: float) -> Plane | None:
    """The plane with the most inliers, its normal towards the camera.

    RANSAC with planes through three points each, then iteratively reweighted least squares over the inliers. It is
    deterministic.

    Args:
        points: (n, 3), m, in the camera frame, z > 0.
        below_weight: how many inliers one point below the plane cancels. In a view of the middle of a table nothing
            lies below it, but much lies below an object's top; in a view beyond its edges the floor lies below it.

    Returns:
        The plane in the camera frame; None if no plane has enough of the points.
    """
    if len(points) < _MIN_POINTS:
        return None
    voters = points[:: max(1, len(points) // _MAX_SCORED)]
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
    noise = 3 * (kinect_depth_std(voters[:, 2]) / voters[:, 2]) * np.abs(along) + 1e-3
    score = (np.abs(heights) < noise).sum(axis=1) - below_weight * (heights < -2 * noise).sum(axis=1)
    best = int(np.argmax(score))
    return _refine(points, Plane(normals[best], float(offsets[best])))


def _refine(points: Array, plane: Plane) -> Plane | None:
    fitted = points[:: max(1, len(points) // _MAX_FITTED)]
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
