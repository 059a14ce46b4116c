"""Says so where the object looks round: its turn about its axis cannot be found, and need not be for points on it."""

from __future__ import annotations

import numpy as np

from pretouch.estimate import Estimate, point_error
from pretouch.geometry import Array
from pretouch.rotational_symmetry import find_symmetry_axis
from pretouch.scene import Scene
from pretouch.session import Tolerance
from pretouch.session_warning import SessionWarning

_MAX_POINTS = 5000
_SHARE = 0.5
"""Of the tolerance: a turn that leaves more of it cannot be neglected beside what else is uncertain."""


def check_symmetry(tolerance: Tolerance, scene: Scene, prior: Estimate) -> tuple[SessionWarning, ...]:
    """That the object is round about the vertical, if its turn matters for the tolerance.

    Args:
        prior: the estimate before the first scan.
    """
    cloud, up = scene.cloud[:: -(-len(scene.cloud) // _MAX_POINTS)], scene.table.normal
    found = find_symmetry_axis(cloud, up)
    if found is None or not found.certain:
        return ()
    turn = _compute_turn_covariance(prior.covariance, up, scene.centroid - found.point)
    points = cloud if tolerance.at is None else tolerance.at
    _, (left,) = point_error(turn, points, scene.centroid, (tolerance.confidence,))
    if left <= _SHARE * tolerance.error:
        return ()
    heights = scene.table.height(cloud)
    foot = found.point - scene.table.height(found.point) * up
    axis = ", ".join(_format(foot + height * up) for height in (0.5 * heights.max(), heights.max()))
    return (
        SessionWarning(
            "object-round",
            f"The object looks round about the vertical through {_format(found.point)} m in base: scans do not tell "
            f"how far it is turned about it, and that alone leaves an error of up to {1000 * left:.1f} mm at "
            f"{100 * tolerance.confidence:.4g} % confidence; {1000 * tolerance.error:g} mm are tolerated.",
            f"If its turn does not matter for the task, send tolerance.at with points on its axis, such as [{axis}].",
        ),
    )


def _compute_turn_covariance(covariance: Array, up: Array, arm: Array) -> Array:
    """(6, 6): of turns about the axis alone, whose variance is that of `covariance` (6, 6); `arm` (3,), m, leads from
    the axis to the centroid.
    """
    direction = np.concatenate([up, np.cross(up, arm)])
    return np.asarray(float(up @ covariance[:3, :3] @ up) * np.outer(direction, direction), dtype=np.float64)


def _format(point: Array) -> str:
    return "[" + ", ".join(f"{value:.3f}" for value in point) + "]"
