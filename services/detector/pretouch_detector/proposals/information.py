"""The linearised information about the pose that a scan along a perimeter would give, from the view alone.

The beam is along the table's normal. Where it meets a surface of height z(x, y) above the table, a small motion of the
world changes its range by n . (w x p + d), n = (-dz/dx, -dz/dy, 1): each beam is one row of information about (w, d),
after Gelfand et al., "Geometrically Stable Sampling for the ICP Algorithm" (2003). The table counts like the object,
since they move as one: it constrains height and tilt. An edge (silhouette, step or crease) is where the slope is steep
or changes: it constrains the pose across the edge, as precisely as the camera located the edge. Beams that would end
beyond the sensor's range only show where the object ends.

Since the camera is miscalibrated, a scan does not hit exactly what its perimeter shows. The covariance after the scan
is therefore averaged over the displacements that the calibration prior allows.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from pretouch.geometry import Array
from pretouch.prior import Prior
from pretouch.scene import SCAN_MARGIN, Scene
from pretouch.tof import Sensor
from pretouch_detector.proposals.displaced import average_square_errors
from pretouch_detector.proposals.paths import trace_perimeters
from pretouch_detector.proposals.relief import Relief, map_relief

_HEIGHT_STD = 0.002
"""m: standard deviation of the camera's points along the surface normal."""
_PLACE_STD = 0.006
"""m: the same across the normal."""
_SMOOTHING = 0.0075
"""m: the length over which slopes are computed."""
_STEEP = 0.3
"""Slope above which a beam counts although it may miss: it still shows where the object ends."""
_BEAMS = 30
"""Beams that are evaluated for each candidate, evenly spaced along its path."""
_INDEPENDENT, _INDEPENDENT_LENGTH, _INDEPENDENT_POWER = 12.0, 0.2, 0.3
"""Effective number of beams on a path of 0.2 m, and the power of the length by which it grows."""
_CLEARANCE, _CLEARED = 0.055, 0.03
"""m: the tip's height above the highest point within the radius _CLEARED, m, of the beam."""
_RINGS, _HEADINGS = (0.6, 1.5), 8
_DISPLACED = np.array(
    [
        (radius * np.cos(heading), radius * np.sin(heading), 1.0 if k % 2 else -1.0)
        for ring, radius in enumerate(_RINGS)
        for k, heading in enumerate(2 * np.pi * (np.arange(_HEADINGS) + 0.5 * ring) / _HEADINGS)
    ]
)
"""(t, 3): shifts in the table's plane and turns about its normal, in standard deviations of the prior."""


def predict_errors_after_scans(
    scene: Scene, sensor: Sensor, rectangles: Array, prior: Prior | None = None
) -> tuple[Array, float]:
    """Root mean square errors (n,), m, of the object's points after a scan along each perimeter, and before any scan.

    Args:
        rectangles: (n, 5) as [x, y, w, h, theta], px and rad.
    """
    prior = prior or Prior()
    seen = map_relief(scene)
    boxes = np.ascontiguousarray(rectangles, dtype=np.float64)
    ways, lengths = trace_perimeters(
        boxes, seen.places, seen.first, seen.step, seen.away, seen.grid, SCAN_MARGIN, _BEAMS
    )
    independent = _INDEPENDENT * (lengths / _INDEPENDENT_LENGTH) ** _INDEPENDENT_POWER / _BEAMS
    shifts = _DISPLACED * (prior.translation_std, prior.translation_std, prior.rotation_std)
    lever = _compute_lever(seen.spread)
    precision = np.diag(1.0 / np.diag(prior.covariance))
    squares = average_square_errors(
        _linearise_beams(seen, sensor), seen.grid, ways, independent, shifts, precision, lever
    )
    return np.sqrt(squares), float(np.sqrt(np.trace(lever.T @ prior.covariance @ lever)))


def _compute_lever(spread: Array) -> Array:
    """(6, 6): trace(lever^T C lever) is the mean square motion, m^2, of points by a pose's covariance C (6, 6).

    A turn w moves points of second moment `spread` (3, 3), m^2, by w^T (trace(spread) I - spread) w in mean square.
    """
    values, axes = np.linalg.eigh(np.trace(spread) * np.eye(3) - spread)
    lever = np.eye(6)
    lever[:3, :3] = axes * np.sqrt(np.maximum(values, 0.0))
    return lever


def _linearise_beams(seen: Relief, sensor: Sensor) -> Array:
    """(nx, ny, 6): the Jacobian of a beam over each cell by a pose about the centroid, in units of its noise.

    Table axes; zero where the camera saw neither object nor table.
    """
    cleared = 2 * int(np.ceil(_CLEARED / seen.grid.cell)) + 1
    deepest = ndimage.maximum_filter(seen.height, size=cleared) + _CLEARANCE - sensor.range_max
    reached = ndimage.gaussian_filter(np.maximum(seen.height, deepest), _SMOOTHING / seen.grid.cell)
    slope_x, slope_y = np.gradient(reached, seen.grid.cell)
    squared = slope_x**2 + slope_y**2
    spot = sensor.spot_radius / 2
    variance = _HEIGHT_STD**2 + sensor.range_std**2 + (_PLACE_STD**2 + spot**2) * squared
    informative = seen.known & ((seen.height >= deepest) | (squared > _STEEP**2))
    x, y = (seen.grid.corner[k] + seen.grid.cell * np.arange(n) for k, n in enumerate(seen.grid.shape))
    normal = np.stack([-slope_x, -slope_y, np.ones_like(reached)], axis=-1)
    arm = np.stack([*np.broadcast_arrays(x[:, None], y[None, :]), reached - seen.centre_height], axis=-1)
    rows = np.concatenate([np.cross(arm, normal), normal], axis=-1)
    return np.asarray(rows * np.where(informative, variance**-0.5, 0.0)[..., None], dtype=np.float64)
