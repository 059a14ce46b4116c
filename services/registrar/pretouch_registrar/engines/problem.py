"""What the engines get: one scene's model and the beams on it, as named tuples that the compiled kernels take."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pretouch.estimate import Prior
from pretouch.geometry import Array
from pretouch.tof import Scan, Sensor
from pretouch_registrar.engines.camera_model import CameraModel, Footprint, Pixels
from pretouch_registrar.engines.rays import Rays, no_rays, rays_of

SURFACE_STD = 0.0020
"""m: how well a smoothed surface point of the camera is known, as one local patch."""
TABLE_STD = 0.0010
"""m: how well the table's plane is known."""
EDGE_STD = 0.0025
"""m: how well the silhouette is known, laterally."""
EFFECTIVE_SAMPLES = 30.0
"""Independent samples that one scan is worth: neighbours share the model's error."""
_MOST = 0.6
"""Weight of one sample at most: at the posterior's temperature it counts once."""
_PATCH = 0.009
"""m along a scan over which the camera's error stays the same."""
WIDE = float(np.radians(2.0))
"""rad: a beam with a larger half angle is treated as a cone."""
CONE_STD = 0.001
"""m: what the model of the cone gets wrong."""


class Beams(NamedTuple):
    """n beams of all scans, where the finger says they are; base frame.

    Attributes:
        points: (n, 3), m: the return's point, or the start of a beam that met nothing.
        directions: (n, 3), unit.
        returned: (n,) bool.
        weights: (n,) what each sample counts in the cost.
        ranges: (n,), m; 0 for a miss.
    """

    points: Array
    directions: Array
    returned: NDArray[np.bool_]
    weights: Array
    ranges: Array


class Optics(NamedTuple):
    """Where the camera stands, how it projects, and how far the finger sees.

    Attributes:
        rotation: (3, 3) of `base_T_camera`.
        position: (3,), m, of `base_T_camera`.
        fx, fy, cx, cy: px.
        range_max: m, of the finger's sensor.
    """

    rotation: Array
    position: Array
    fx: float
    fy: float
    cx: float
    cy: float
    range_max: float


class Table(NamedTuple):
    """The table's plane in base, as the camera puts it: normal (3,), unit, and offset, m, of normal . p = offset."""

    normal: Array
    offset: float


class Noise(NamedTuple):
    """Standard deviations of the residuals, m.

    Attributes:
        surface: along the normal of what the camera saw.
        table: of the height above the table.
        edge: off the silhouette, laterally.
        widening: the factor by which the others are wider than they truly are.
    """

    surface: float
    table: float
    edge: float
    widening: float

    def widened(self, factor: float) -> Noise:
        """All `factor` times as wide."""
        return Noise(self.surface * factor, self.table * factor, self.edge * factor, self.widening * factor)


class Target(NamedTuple):
    """What the beams are matched with: all that the camera saw; corrections turn about `centroid` (3,), m."""

    centroid: Array
    optics: Optics
    table: Table
    pixels: Pixels
    footprint: Footprint


class Problem(NamedTuple):
    """All that the objective depends on besides the correction.

    Attributes:
        rays: of a wide beam's cone; none for a thin one.
        prior: (6,) inverse variances of the correction, order (w, d).
    """

    beams: Beams
    target: Target
    noise: Noise
    rays: Rays
    prior: Array

    @property
    def wide(self) -> bool:
        """Whether the beams are cones."""
        return len(self.rays.response) > 0

    def free(self) -> Problem:
        """The same without the prior."""
        return self._replace(prior=np.zeros(6))

    def widened(self, factor: float) -> Problem:
        """The same with noise `factor` times as wide."""
        return self._replace(noise=self.noise.widened(factor))

    def thinned(self, most: int) -> Problem:
        """The same with at most `most` of the beams, evenly in their order, which count for the others."""
        step = max(1, -(-len(self.beams.weights) // most))
        b, one_in = self.beams, slice(None, None, step)
        kept = Beams(
            np.ascontiguousarray(b.points[one_in]),
            np.ascontiguousarray(b.directions[one_in]),
            np.ascontiguousarray(b.returned[one_in]),
            b.weights[one_in] * step,
            np.ascontiguousarray(b.ranges[one_in]),
        )
        return self._replace(beams=kept)


def beams_of(scans: Sequence[Scan], sensor: Sensor) -> Beams:
    """The beams of all scans; each scan is worth EFFECTIVE_SAMPLES independent samples at most, however long.

    A wide beam's spots overlap, so that its samples are worth less still.
    """
    worth = EFFECTIVE_SAMPLES * _PATCH / (_PATCH + 2 * _spot_radius(sensor))
    ranges = [np.where(scan.returned, scan.ranges, 0.0) for scan in scans]
    ends = [scan.origins + r[:, None] * scan.directions for scan, r in zip(scans, ranges, strict=True)]
    weights = [np.full(len(scan), min(_MOST, worth / max(len(scan), 1))) for scan in scans]
    return Beams(
        np.concatenate([np.zeros((0, 3)), *ends]),
        np.concatenate([np.zeros((0, 3)), *(scan.directions for scan in scans)]),
        np.concatenate([np.zeros(0, dtype=np.bool_), *(scan.returned for scan in scans)]),
        np.concatenate([np.zeros(0), *weights]),
        np.concatenate([np.zeros(0), *ranges]),
    )


def _spot_radius(sensor: Sensor) -> float:
    """m: radius of the beam's spot in the middle of the sensor's range."""
    return float(0.5 * (sensor.range_min + sensor.range_max) * np.tan(sensor.beam_half_angle))


def _noise_of(sensor: Sensor) -> Noise:
    if sensor.beam_half_angle > WIDE:
        surface = float(np.hypot(np.hypot(sensor.range_std, SURFACE_STD), CONE_STD))
        return Noise(surface, CONE_STD, EDGE_STD, 1.0)
    spot = _spot_radius(sensor)
    return Noise(
        float(np.hypot(np.hypot(sensor.range_std, SURFACE_STD), spot / 5)),
        float(np.hypot(np.hypot(sensor.range_std, TABLE_STD), spot / 5)),
        float(np.hypot(EDGE_STD, spot / 2)),
        1.0,
    )


def pose_problem(model: CameraModel, scans: Sequence[Scan], prior: Prior, sensor: Sensor) -> Problem:
    """Packs a scene's model and its scans for the kernels."""
    scene = model.scene
    pose, camera = scene.base_T_camera, scene.camera
    optics = Optics(
        np.array(pose.rotation, order="C"), np.array(pose.translation),
        float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy), float(sensor.range_max),
    )  # fmt: skip
    table = Table(np.array(scene.table.normal), float(scene.table.offset))
    inverse = np.array([prior.rotation_std**-2.0] * 3 + [prior.translation_std**-2.0] * 3)
    rays = rays_of(sensor.beam_half_angle) if sensor.beam_half_angle > WIDE else no_rays()
    target = Target(np.array(scene.centroid), optics, table, model.pixels, model.footprint)
    return Problem(beams_of(scans, sensor), target, _noise_of(sensor), rays, inverse)
