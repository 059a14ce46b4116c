"""One scene's model and the scans on it, packed for the compiled kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pretouch.estimate import Prior
from pretouch.geometry import Array
from pretouch.tof import Scan, Sensor
from pretouch_registrar.engines.camera_model import CameraModel
from pretouch_registrar.engines.cone import rays_of

SURFACE_STD = 0.0020
"""m: how well a smoothed surface point of the camera is known, as one local patch."""
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


@dataclass(frozen=True, eq=False)
class Problem:
    """One scene's model and the scans, packed for the compiled kernels.

    Attributes:
        beams: (n, 9): point of the return or start of the beam (3), direction (3), 1 for a return else 0, weight,
            range, m, 0 for a miss.
        optics: (17,): camera rotation (9), position (3), fx, fy, cx, cy, range_max.
        table: (4,): normal (3), offset.
        noise: (4,): standard deviations of surface, table and edge residuals, m, then 1; all widened in annealing.
        rays: (k, 4) of a wide beam's cone, see `cone.rays_of`; k = 0 for a thin beam.
        prior: (6,) inverse variances, order (w, d).
    """

    model: CameraModel
    beams: Array
    optics: Array
    table: Array
    noise: Array
    rays: Array
    prior: Array
    centroid: Array

    def arguments(self) -> tuple[Any, ...]:
        """What every kernel takes after the pose."""
        m = self.model
        return self.beams, self.centroid, self.optics, self.table, self.noise, self.rays, m.pixels, m.footprint, m.frame


def beam_rows(scans: Sequence[Scan], sensor: Sensor) -> Array:
    """The scans as `Problem.beams`; each is worth EFFECTIVE_SAMPLES independent samples at most, however long.

    A wide beam's spots overlap, so that its samples are worth less still.
    """
    worth = EFFECTIVE_SAMPLES * _PATCH / (_PATCH + 2 * _spot_radius(sensor))
    rows = [np.zeros((0, 9))]
    for scan in scans:
        hit = scan.returned
        ends = scan.origins + np.where(hit, scan.ranges, 0.0)[:, None] * scan.directions
        weight = min(_MOST, worth / max(len(scan), 1))
        rows.append(
            np.column_stack([ends, scan.directions, hit, np.full(len(scan), weight), np.where(hit, scan.ranges, 0.0)])
        )
    return np.ascontiguousarray(np.concatenate(rows))


def _spot_radius(sensor: Sensor) -> float:
    """m: radius of the beam's spot in the middle of the sensor's range."""
    return float(0.5 * (sensor.range_min + sensor.range_max) * np.tan(sensor.beam_half_angle))


def pose_problem(model: CameraModel, scans: Sequence[Scan], prior: Prior, sensor: Sensor) -> Problem:
    """Packs a scene's model and its scans for the kernels."""
    scene = model.scene
    pose, camera = scene.base_T_camera, scene.camera
    optics = np.concatenate(
        [pose.rotation.ravel(), pose.translation, [camera.fx, camera.fy, camera.cx, camera.cy, sensor.range_max]]
    )
    spot = _spot_radius(sensor)
    noise = np.array(
        [
            np.hypot(np.hypot(sensor.range_std, SURFACE_STD), spot / 5),
            np.hypot(np.hypot(sensor.range_std, 0.001), spot / 5),
            np.hypot(EDGE_STD, spot / 2),
            1.0,
        ]
    )
    if sensor.beam_half_angle > WIDE:
        noise = np.array([np.hypot(np.hypot(sensor.range_std, SURFACE_STD), CONE_STD), CONE_STD, EDGE_STD, 1.0])
    table = np.array([*scene.table.normal, scene.table.offset])
    inverse = np.array([prior.rotation_std**-2.0] * 3 + [prior.translation_std**-2.0] * 3)
    rays = rays_of(sensor.beam_half_angle) if sensor.beam_half_angle > WIDE else np.zeros((0, 4))
    return Problem(model, beam_rows(scans, sensor), optics, table, noise, rays, inverse, np.array(scene.centroid))
