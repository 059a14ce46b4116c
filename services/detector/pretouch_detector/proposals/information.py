"""What a scan along a perimeter would tell about the pose: linear, from the view alone, many candidates at once.

The beam is along the table's normal. Where it meets a surface of height z(x, y) above the table, a small motion of the
world changes its range by n . (w x p + d), n = (-dz/dx, -dz/dy, 1): each beam is one row of information about (w, d),
after Gelfand et al., "Geometrically Stable Sampling for the ICP Algorithm" (2003). The table counts like the object,
since they move as one: it fixes height and tilt. An edge, be it the silhouette or a step or crease within it, is where
the slope is steep or changes: it fixes the pose across itself, no better than the camera saw where it is. Beams that
would end beyond the sensor's range tell nothing but where the object ends.

The object is not where the camera puts it, so that a scan does not meet what its perimeter shows. The covariance that
it would leave is therefore the mean over displacements that the calibration prior allows.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from pretouch.estimate import Prior
from pretouch.geometry import Array
from pretouch.scene import Scene
from pretouch.tof import Sensor
from pretouch_detector.proposals.relief import Relief, relief

_HEIGHT_STD = 0.002
"""m: of what the camera saw, along the normal; and across it:"""
_PLACE_STD = 0.006
_SMOOTHING = 0.0075
"""m: slopes are taken over about so much."""
_STEEP = 0.3
"""Slope from which on a beam that may miss still tells where the object ends."""
_BEAMS = 30
"""Beams of a candidate that are looked at, evenly along its path."""
_INDEPENDENT, _INDEPENDENT_LENGTH, _INDEPENDENT_POWER = 12.0, 0.2, 0.3
"""Beams that a path of 0.2 m is worth, and how that grows with its length: neighbours share the camera's error."""
_NEAR_OBJECT = 0.015
"""m from the object, over the ground, beyond which nothing is scanned."""
_CLEARANCE, _CLEARED = 0.055, 0.03
"""m that the tip is above the highest point, within so many metres of the beam."""
_PERIMETER_STEPS = 120
_RINGS, _HEADINGS = (0.6, 1.5), 8
_DISPLACED = np.array(
    [
        (radius * np.cos(heading), radius * np.sin(heading), 1.0 if k % 2 else -1.0)
        for ring, radius in enumerate(_RINGS)
        for k, heading in enumerate(2 * np.pi * (np.arange(_HEADINGS) + 0.5 * ring) / _HEADINGS)
    ]
)
"""(t, 3): shifts in the table's plane and turns about its normal, in standard deviations of the prior."""


def remaining_error(scene: Scene, sensor: Sensor, rectangles: Array, prior: Prior | None = None) -> tuple[Array, float]:
    """Root mean square errors (n,), m, of the object's points after a scan along each perimeter, and before any scan.

    Args:
        rectangles: (n, 5) as [x, y, w, h, theta], px and rad.
    """
    from pretouch_detector.proposals.displaced import mean_covariance  # here, since numba takes a second to import

    prior = prior or Prior()
    seen = relief(scene)
    paths, lengths = _paths(seen, rectangles)
    independent = _INDEPENDENT * (lengths / _INDEPENDENT_LENGTH) ** _INDEPENDENT_POWER / _BEAMS
    rows = _rows(seen, sensor)
    precision = np.diag(1.0 / np.diag(prior.covariance()))
    shifts = _DISPLACED * (prior.translation_std, prior.translation_std, prior.rotation_std)
    covariance = mean_covariance(rows, seen.corner, seen.cell, paths, independent, shifts, precision)
    turned = np.trace(seen.spread) * np.eye(3) - seen.spread

    def error(covariances: Array) -> Array:
        squares = np.einsum("ij,...ij->...", turned, covariances[..., :3, :3])
        return np.asarray(np.sqrt(squares + np.trace(covariances[..., 3:, 3:], axis1=-2, axis2=-1)), dtype=np.float64)

    return error(covariance), float(error(prior.covariance()))


def _rows(seen: Relief, sensor: Sensor) -> Array:
    """(nx, ny, 6): what a beam over each cell tells, in units of its noise, of a pose about the centroid, table axes.

    Nothing where the camera saw neither object nor table.
    """
    cleared = 2 * int(np.ceil(_CLEARED / seen.cell)) + 1
    deepest = ndimage.maximum_filter(seen.height, size=cleared) + _CLEARANCE - sensor.range_max
    reached = ndimage.gaussian_filter(np.maximum(seen.height, deepest), _SMOOTHING / seen.cell)
    slope_x, slope_y = np.gradient(reached, seen.cell)
    squared = slope_x**2 + slope_y**2
    spot = 0.5 * (sensor.range_min + sensor.range_max) * np.tan(sensor.beam_half_angle) / 2
    variance = _HEIGHT_STD**2 + sensor.range_std**2 + (_PLACE_STD**2 + spot**2) * squared
    tells = seen.known & ((seen.height >= deepest) | (squared > _STEEP**2))
    x, y = (seen.corner[k] + seen.cell * np.arange(n) for k, n in enumerate(seen.height.shape))
    normal = np.stack([-slope_x, -slope_y, np.ones_like(reached)], axis=-1)
    arm = np.stack([*np.broadcast_arrays(x[:, None], y[None, :]), reached - seen.centre_height], axis=-1)
    rows = np.concatenate([np.cross(arm, normal), normal], axis=-1)
    return np.asarray(rows * np.where(tells, variance**-0.5, 0.0)[..., None], dtype=np.float64)


def _paths(seen: Relief, rectangles: Array) -> tuple[Array, Array]:
    """Places (n, _BEAMS, 2) over the ground along each perimeter, m, and the paths' lengths (n,), m.

    Stretches that show neither object nor table, or lie far from the object, are crossed straight. A perimeter that
    never comes near has length 0.
    """
    pixels = np.rint((_perimeters(rectangles) - seen.first) / seen.step).astype(np.intp)
    h, w = seen.places.shape[:2]
    u, v = pixels[..., 0].clip(0, w - 1), pixels[..., 1].clip(0, h - 1)
    inside = (pixels[..., 0] == u) & (pixels[..., 1] == v)
    places = seen.places[v, u]
    inside &= ~np.isnan(places[..., 0])
    inside &= seen.away[seen.index(np.nan_to_num(places))] <= _NEAR_OBJECT
    row, _ = np.nonzero(inside)
    if len(row) == 0:
        return np.zeros((len(rectangles), _BEAMS, 2)), np.zeros(len(rectangles))
    line = places[inside] @ (1.0, 1j)
    steps = np.where(row[1:] == row[:-1], np.abs(np.diff(line)), 0.0)
    travelled = np.concatenate([[0.0], np.cumsum(steps)])
    counts = inside.sum(axis=1)
    last = counts.cumsum() - 1
    start = travelled[np.minimum(last + 1 - counts, len(row) - 1)]
    lengths = np.where(counts > 0, travelled[last] - start, 0.0)
    at = start[:, None] + (np.arange(_BEAMS) + 0.5) / _BEAMS * lengths[:, None]
    met = np.interp(at, travelled, line)
    return np.stack([met.real, met.imag], axis=-1), lengths


def _perimeters(rectangles: Array) -> Array:
    """(n, _PERIMETER_STEPS, 2) pixels, evenly along each perimeter."""
    x, y, w, h, theta = rectangles.T[..., None]
    s = np.arange(_PERIMETER_STEPS) / _PERIMETER_STEPS * 2 * (w + h)
    a = s.clip(0, w) - (s - w - h).clip(0, w) - w / 2
    b = (s - w).clip(0, h) - (s - 2 * w - h).clip(0, h) - h / 2
    c, sine = np.cos(theta), np.sin(theta)
    return np.stack([x + c * a - sine * b, y + sine * a + c * b], axis=-1)
