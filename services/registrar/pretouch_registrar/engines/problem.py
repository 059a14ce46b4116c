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
from pretouch_registrar.engines.camera_noise import PATCH, CameraNoise
from pretouch_registrar.engines.cone import Cone, cone_of, thin_beam
from pretouch_registrar.engines.patches import Patches, SharedError, patches_of, sample_weights

SURFACE_STD, TABLE_STD, EDGE_STD, RIM_STD = 0.0012, 0.0007, 0.0022, 0.001
"""m: how well a perfect camera's smoothed surface, table and silhouette are known, and the surface at the silhouette
besides: the model's own errors."""
_TABLE_SHARE, _RIM_SHARE = 0.7, 1.5
"""Of the camera's patch error: how much of it the table has, whose plane is fitted, and the surface at its rim."""
_SCAN_BIAS = 0.0007
"""m: error that all ranges of a scan share; real modules wander by 0.5 to 1 mm from one minute to the next."""
_LOCAL_STD = 0.001
"""m: what the model gets wrong from one sample to the next."""
WIDE = float(np.radians(2.0))
"""rad: a beam with a larger half angle is treated as a cone."""
CONE_STD = 0.0020
"""m: what the hypotheses about a cone get wrong."""
_CONE_SHARED, _CONE_PATCH = 0.0025, 0.02
"""m: error of the cone's model that neighbouring spots share, and over which length."""
_TEMPERATURE, _ROUGH, _WIDE_TEMPERATURE, _GROWTH, _INDEPENDENT = 1.7, 0.8, 2.2, 0.25, 60.0
"""The costs are divided by the temperature of a thin or of a wide beam, and by more for more than _INDEPENDENT samples'
worth: what the model gets wrong all over. Chosen on training meshes and two real frames by the log score of the truth.
A thin beam's grows by up to _ROUGH with the camera's patch error, up to _ROUGH_PATCH, m: what errs by patches errs as a
whole too, which the table does not show."""
_ROUGH_PATCH = 0.001
_POOL, _POOL_TURN = 0.006, 0.05
"""m and rad: a wide beam's samples from places and in directions that differ by less are taken together."""
_SYSTEMATIC, _CONE_SYSTEMATIC = 0.0005, 0.0028
"""m: what a sensor errs by all over, thin beam and cone: its bias, and the direction in which it truly looks."""
_CAMERA_SHARE, _CAMERA_TURN = 1.1, 10.0
"""The same of the camera, which shifts and turns what it sees: m and rad for each m of its patches' error."""


class Beams(NamedTuple):
    """n beams of all scans, where the finger says they are; base frame.

    Attributes:
        points: (n, 3), m: the return's point, or the start of a beam that met nothing.
        directions: (n, 3), unit.
        returned: (n,) bool.
        weights: (n,) what each sample counts in the cost: independent samples that it is worth.
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
        rim: of the surface at its silhouette, besides `surface`.
        widening: the factor by which the others are wider than they truly are.
    """

    surface: float
    table: float
    edge: float
    rim: float
    widening: float

    def widened(self, factor: float) -> Noise:
        """All `factor` times as wide."""
        return Noise(*(value * factor for value in self))


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
        cone: of a wide beam; without rays for a thin one.
        prior: (6,) inverse variances of the correction, order (w, d).
        temperature: what the cost is divided by to be a negative log likelihood.
        shared: what neighbouring samples err together.
        systematic: (6, 6) covariance of the correction that no number of samples reduces.
        free_turn: (6,), see `CameraModel`; 0 without.
    """

    beams: Beams
    target: Target
    noise: Noise
    cone: Cone
    prior: Array
    temperature: float
    shared: SharedError
    systematic: Array
    free_turn: Array

    @property
    def wide(self) -> bool:
        """Whether the beams are cones."""
        return len(self.cone.length) > 0

    def temperature_with(self, further: float) -> float:
        """The temperature after further samples that are together worth so many independent ones."""
        worth = float(self.beams.weights.sum())
        return self.temperature * _growth(worth + further) / _growth(worth)

    def free(self) -> Problem:
        """The same without the prior."""
        return self._replace(prior=np.zeros(6))

    def widened(self, factor: float) -> Problem:
        """The same with noise `factor` times as wide."""
        return self._replace(noise=self.noise.widened(factor))

    def supposing(self, hypothesis: int) -> Problem:
        """The same with one hypothesis about the cone."""
        return self._replace(cone=self.cone.only(hypothesis))

    def pooled(self) -> Problem:
        """The same with one beam for all that a module measured from about the same place: their median range.

        A wide beam's spot hardly changes over a few millimetres, but noise and outliers average out.
        """
        b = self.beams
        if not len(b.ranges):
            return self
        origins = b.points - b.ranges[:, None] * b.directions
        keys = np.column_stack([np.floor(origins / _POOL), np.round(b.directions / _POOL_TURN), b.returned])
        _, first, place, count = np.unique(keys, axis=0, return_index=True, return_inverse=True, return_counts=True)
        place = place.ravel()
        in_order = np.argsort(first)
        ranges = np.array([np.median(b.ranges[place == k]) for k in in_order])
        origin, direction = (_means(values, place, count)[in_order] for values in (origins, b.directions))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        weights = np.bincount(place, b.weights)[in_order].astype(np.float64)
        ends = origin + ranges[:, None] * direction
        return self._replace(beams=Beams(ends, direction, b.returned[first[in_order]], weights, ranges))

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


def _means(values: Array, place: NDArray[np.intp], count: NDArray[np.intp]) -> Array:
    """(k, 3): the mean of the rows of values (n, 3) that go to each of the k places, given by `place` (n,)."""
    return np.column_stack([np.bincount(place, column) / count for column in values.T])


def _temperature(worth: float, wide: bool, camera: CameraNoise) -> float:
    """`Problem.temperature` for samples of a wide or a thin beam, together worth as many independent ones."""
    thin = _TEMPERATURE + _ROUGH * min(camera.patch / _ROUGH_PATCH, 1.0)
    return (_WIDE_TEMPERATURE if wide else thin) * _growth(worth)


def _growth(worth: float) -> float:
    return float(max(worth / _INDEPENDENT, 1.0) ** _GROWTH)


def shared_error(sensor: Sensor, camera: CameraNoise) -> SharedError:
    """What samples have in common with their neighbours: the camera's error, the scan's bias, the cone's model."""
    common, patch = float(np.hypot(camera.patch, _SCAN_BIAS)), PATCH
    if sensor.beam_half_angle > WIDE:
        common, patch = float(np.hypot(common, _CONE_SHARED)), _CONE_PATCH
    return SharedError(float(np.hypot(sensor.range_std, _LOCAL_STD)), common, patch)


def beams_of(scans: Sequence[Scan], error: SharedError, each: float = 1.0, earlier: Patches | None = None) -> Beams:
    """The beams of all scans; `each` and `earlier` as `patches.sample_weights` takes them."""
    ranges = [np.where(scan.returned, scan.ranges, 0.0) for scan in scans]
    ends = [scan.origins + r[:, None] * scan.directions for scan, r in zip(scans, ranges, strict=True)]
    points = np.concatenate([np.zeros((0, 3)), *ends])
    directions = np.concatenate([np.zeros((0, 3)), *(scan.directions for scan in scans)])
    returned = np.concatenate([np.zeros(0, dtype=np.bool_), *(scan.returned for scan in scans)])
    weights = sample_weights(points, directions, returned, error, each, earlier)
    return Beams(points, directions, returned, weights, np.concatenate([np.zeros(0), *ranges]))


def patches_among(beams: Beams, error: SharedError) -> Patches:
    """In which patches of the world the beams' samples lie."""
    return patches_of(beams.points, beams.directions, beams.returned, error)


def _noise_of(sensor: Sensor, camera: CameraNoise) -> Noise:
    wide = sensor.beam_half_angle > WIDE
    spot = 0.0 if wide else 0.5 * (sensor.range_min + sensor.range_max) * np.tan(sensor.beam_half_angle)
    return Noise(
        surface=float(np.linalg.norm([sensor.range_std, SURFACE_STD, camera.patch, CONE_STD * wide, spot / 5])),
        table=float(np.linalg.norm([sensor.range_std, TABLE_STD, _TABLE_SHARE * camera.patch, spot / 5])),
        edge=float(np.linalg.norm([EDGE_STD, camera.patch, spot / 2])),
        rim=RIM_STD + _RIM_SHARE * camera.patch,
        widening=1.0,
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
    inverse = prior.inverse_variances()
    cone = cone_of(sensor.beam_half_angle) if sensor.beam_half_angle > WIDE else thin_beam()
    target = Target(np.array(scene.centroid), optics, table, model.pixels, model.footprint)
    shared = shared_error(sensor, model.noise)
    beams = beams_of(scans, shared)
    free_turn = np.zeros(6) if model.free_turn is None else model.free_turn
    return Problem(
        beams,
        target,
        _noise_of(sensor, model.noise),
        cone,
        inverse,
        _temperature(float(beams.weights.sum()), sensor.beam_half_angle > WIDE, model.noise),
        shared,
        _systematic(sensor, model.noise, inverse, free_turn),
        free_turn,
    )


def _systematic(sensor: Sensor, camera: CameraNoise, prior: Array, free_turn: Array) -> Array:
    """`Problem.systematic`: what sensor and camera err by all over, no more than a quarter of the variance of a tight
    prior, given by its inverse (6,); and all of the prior's about a free turn."""
    own = _CONE_SYSTEMATIC if sensor.beam_half_angle > WIDE else _SYSTEMATIC
    shift, turn = float(np.hypot(own, _CAMERA_SHARE * camera.patch)), _CAMERA_TURN * camera.patch
    shared = np.minimum(np.array([turn**2] * 3 + [shift**2] * 3), 0.25 / prior)
    information = float(free_turn @ (prior * free_turn))
    if information == 0.0:
        return np.diag(shared)
    return np.asarray(np.diag(shared) + np.outer(free_turn, free_turn) / information, dtype=np.float64)
