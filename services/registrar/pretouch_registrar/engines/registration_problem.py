"""The registration problem that engines solve, as named tuples for compiled kernels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch.prior import AnyPrior
from pretouch.tof import Scan, Sensor
from pretouch_registrar.engines.beam_response import Cone, make_cone, make_thin_beam
from pretouch_registrar.engines.camera_model import CameraModel, Footprint, Pixels
from pretouch_registrar.engines.camera_noise import PATCH, CameraNoise
from pretouch_registrar.engines.patches import Patches, SharedError, compute_sample_weights, find_patches
from pretouch_registrar.engines.prior import CorrectionPrior

SURFACE_STD, TABLE_STD, EDGE_STD, RIM_STD = 0.0012, 0.0007, 0.0022, 0.001
"""m: the model's own errors, those of a perfect camera: of smoothed surface, table and silhouette, and the additional
one of the surface at the silhouette."""
_TABLE_SHARE, _RIM_SHARE = 0.7, 1.5
"""Shares of the camera's patch error that the table, whose plane is fitted, and the surface at its rim have."""
_SAMPLE_STD = 0.001
"""m: the model's error that is independent for each sample."""
_MODULES_SHARED = 0.0015
"""m: error that samples of several modules share with their neighbours: offsets of modules and of frames, and sides
that slanted modules see and the camera does not. On 14 training meshes, camera `window`, finger `zones`, the error
after one and three scans is 1.06 and 0.55 cm, without it 1.22 and 0.60; 79 and 93 % of the truths lie in the 95 %
region, without it 64 and 93."""
_MIN_WIDE_HALF_ANGLE = float(np.radians(4.0))
"""rad: a beam with a larger half angle is treated as a cone."""
CONE_STD = 0.0020
"""m: error of the hypotheses about a cone."""
_CONE_SHARED, _CONE_PATCH = 0.0025, 0.02
"""m: error of the cone's model that neighbouring spots share, and the length over which they do."""
_TEMPERATURE, _ROUGH, _WIDE_TEMPERATURE, _GROWTH, _INDEPENDENT = 1.7, 0.8, 2.2, 0.25, 60.0
"""The costs are divided by a temperature, one for a thin and one for a wide beam, which accounts for model errors that
all samples share; it grows with the effective number of samples above _INDEPENDENT. Chosen on training meshes and two
real frames by the log score of the truth. That of a thin beam grows by up to _ROUGH with the camera's patch error, up
to _ROUGH_PATCH, m: a camera with errors by patches also has global ones, which the table does not show."""
_ROUGH_PATCH = 0.001
_POOL, _POOL_TURN = 0.006, 0.05
"""m and rad: a wide beam's samples whose positions and directions differ by less are pooled."""
_MERGED, _MERGED_TURN, _MERGED_MISS = (0.003, 0.004, 0.006, 0.008), 0.3, 0.05
"""m and rad: sizes of the places in which a thin beam's samples are merged if there are too many, and differences of
direction; m along a miss: the place that counts."""
_SYSTEMATIC, _CONE_SYSTEMATIC = 0.0005, 0.0028
"""m: systematic error of a sensor whose scans share a bias of the usual size, for a thin beam and a cone: the bias, and
an error of the beam's direction. What a stated bias exceeds the usual one by is added."""
_CAMERA_SHARE, _CAMERA_TURN = 1.1, 10.0
"""Systematic error of the camera, which shifts and turns what it sees: m and rad for each m of its patch error."""


class Beams(NamedTuple):
    """The n beams of all scans as the finger measured them; base frame.

    Attributes:
        points: (n, 3), m: the return's point, or the origin of a beam without a return.
        directions: (n, 3), unit.
        returned: (n,) bool.
        weights: (n,), weight of each sample in the cost: its effective number of samples.
        ranges: (n,), m; 0 for a miss.
    """

    points: Array
    directions: Array
    returned: NDArray[np.bool_]
    weights: Array
    ranges: Array


class Optics(NamedTuple):
    """The camera's pose and intrinsics, and the finger's range.

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
        rim: of the surface at its silhouette, in addition to `surface`.
        widening: the factor by which the others are widened.
    """

    surface: float
    table: float
    edge: float
    rim: float
    widening: float

    def widen(self, factor: float) -> Noise:
        """All standard deviations times `factor`."""
        return Noise(*(value * factor for value in self))


class Target(NamedTuple):
    """What the beams are registered with: all that the camera saw; corrections turn about `centroid` (3,), m."""

    centroid: Array
    optics: Optics
    table: Table
    pixels: Pixels
    footprint: Footprint


class RegistrationProblem(NamedTuple):
    """All that the objective depends on besides the correction.

    Attributes:
        cone: of a wide beam; without rays for a thin one.
        prior: of the correction.
        temperature: the cost is divided by it to be a negative log likelihood.
        shared: the error that neighbouring samples share.
        systematic_covariance: (6, 6) covariance of the correction that no number of samples reduces.
        free_turn: (6,), see `CameraModel`; 0 without.
    """

    beams: Beams
    target: Target
    noise: Noise
    cone: Cone
    prior: CorrectionPrior
    temperature: float
    shared: SharedError
    systematic_covariance: Array
    free_turn: Array

    @property
    def wide(self) -> bool:
        """Whether the beams are cones."""
        return len(self.cone.length) > 0

    def predict_temperature(self, further: float) -> float:
        """The temperature after further samples whose effective number is `further`."""
        effective = float(self.beams.weights.sum())
        return self.temperature * _temperature_growth(effective + further) / _temperature_growth(effective)

    def without_prior(self) -> RegistrationProblem:
        """The problem without the prior."""
        return self._replace(prior=self.prior.removed())

    def widen_noise(self, factor: float) -> RegistrationProblem:
        """The problem with `factor` times the noise."""
        return self._replace(noise=self.noise.widen(factor))

    def assume_hypothesis(self, hypothesis: int) -> RegistrationProblem:
        """The problem with one hypothesis about the cone."""
        return self._replace(cone=self.cone.select_hypothesis(hypothesis))

    def pool_beams(self) -> RegistrationProblem:
        """The problem with one beam of median range for all from about the same place in about the same direction.

        A wide beam's spot hardly changes over a few millimetres, whereas noise and outliers average out.
        """
        b = self.beams
        if not len(b.ranges):
            return self
        origins = b.points - b.ranges[:, None] * b.directions
        keys = np.column_stack([np.floor(origins / _POOL), np.round(b.directions / _POOL_TURN), b.returned])
        groups = _Groups.of(keys)
        ranges = groups.find_medians(b.ranges)
        origin, direction = groups.average(origins), groups.average(b.directions)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        ends = origin + ranges[:, None] * direction
        return self._replace(beams=Beams(ends, direction, b.returned[groups.first], groups.add(b.weights), ranges))

    def merge_neighbours(self, most: int) -> RegistrationProblem:
        """The problem with one beam for all that end in the same place from about the same direction.

        Of a few sizes of places the smallest that leaves at most `most` beams is taken, else the largest: samples of
        many modules overlap, and what they cost is bounded.
        """
        b, problem = self.beams, self
        for cell in _MERGED:
            if len(problem.beams.weights) <= most:
                break
            places = b.points + np.where(b.returned, 0.0, _MERGED_MISS)[:, None] * b.directions
            keys = np.column_stack([np.floor(places / cell), np.round(b.directions / _MERGED_TURN), b.returned])
            groups = _Groups.of(keys)
            directions = groups.average(b.directions)
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
            problem = self._replace(
                beams=Beams(
                    groups.average(b.points),
                    directions,
                    b.returned[groups.first],
                    groups.add(b.weights),
                    groups.average(b.ranges[:, None])[:, 0],
                )
            )
        return problem

    def subsample_beams(self, most: int) -> RegistrationProblem:
        """The problem with at most `most` of the beams, weighted to represent all.

        They are one of each of equal parts of the beams' order, not always the same one: modules take turns.
        """
        b, count = self.beams, len(self.beams.weights)
        if count <= most:
            return self
        within = np.random.default_rng(0).random(most)
        kept = np.minimum((count / most * (np.arange(most) + within)).astype(np.intp), count - 1)
        weights = b.weights[kept]
        weights *= b.weights.sum() / weights.sum()
        return self._replace(beams=Beams(b.points[kept], b.directions[kept], b.returned[kept], weights, b.ranges[kept]))


class _Groups(NamedTuple):
    """Rows in k groups, in the order in which each first appears.

    Attributes:
        place: (n,), the group of each row.
        first: (k,), its first row.
        sizes: (k,), its number of rows.
    """

    place: NDArray[np.intp]
    first: NDArray[np.intp]
    sizes: NDArray[np.intp]

    @staticmethod
    def of(keys: Array) -> _Groups:
        """Groups of equal rows of `keys` (n, m)."""
        _, first, place, sizes = np.unique(keys, axis=0, return_index=True, return_inverse=True, return_counts=True)
        in_order = np.argsort(first)
        rank = np.empty_like(in_order)
        rank[in_order] = np.arange(len(in_order))
        return _Groups(rank[place.ravel()], first[in_order], sizes[in_order])

    def add(self, values: Array) -> Array:
        """(k,): sums of `values` (n,)."""
        return np.bincount(self.place, values).astype(np.float64)

    def average(self, values: Array) -> Array:
        """(k, m): means of the rows of `values` (n, m)."""
        return np.column_stack([np.bincount(self.place, column) / self.sizes for column in values.T])

    def find_medians(self, values: Array) -> Array:
        """(k,): medians of `values` (n,)."""
        ordered = values[np.lexsort((values, self.place))]
        start = np.cumsum(self.sizes) - self.sizes
        return np.asarray(
            0.5 * (ordered[start + (self.sizes - 1) // 2] + ordered[start + self.sizes // 2]), dtype=np.float64
        )


def _compute_temperature(effective: float, wide: bool, camera: CameraNoise) -> float:
    """`RegistrationProblem.temperature` for samples of a wide or a thin beam whose effective number is `effective`."""
    thin = _TEMPERATURE + _ROUGH * min(camera.patch / _ROUGH_PATCH, 1.0)
    return (_WIDE_TEMPERATURE if wide else thin) * _temperature_growth(effective)


def _temperature_growth(effective: float) -> float:
    return float(max(effective / _INDEPENDENT, 1.0) ** _GROWTH)


def _is_wide(sensor: Sensor) -> bool:
    return sensor.beam_half_angle > _MIN_WIDE_HALF_ANGLE


def compute_shared_error(sensor: Sensor, camera: CameraNoise) -> SharedError:
    """The error that samples share with their neighbours: of camera, scan, several modules, and the cone's model."""
    several = _MODULES_SHARED * (len(sensor.tip_T_module) > 1)
    common, patch = float(np.linalg.norm([camera.patch, sensor.range_bias_std, several])), PATCH
    if _is_wide(sensor):
        common, patch = float(np.hypot(common, _CONE_SHARED)), _CONE_PATCH
    return SharedError(float(np.hypot(sensor.range_std, _SAMPLE_STD)), common, patch)


def collect_beams(scans: Sequence[Scan], error: SharedError) -> Beams:
    """The beams of all scans."""
    ranges = [np.where(scan.returned, scan.ranges, 0.0) for scan in scans]
    ends = [scan.origins + r[:, None] * scan.directions for scan, r in zip(scans, ranges, strict=True)]
    points = np.concatenate([np.zeros((0, 3)), *ends])
    directions = np.concatenate([np.zeros((0, 3)), *(scan.directions for scan in scans)])
    returned = np.concatenate([np.zeros(0, dtype=np.bool_), *(scan.returned for scan in scans)])
    weights = compute_sample_weights(points, directions, returned, error)
    return Beams(points, directions, returned, weights, np.concatenate([np.zeros(0), *ranges]))


def find_beam_patches(beams: Beams, error: SharedError) -> Patches:
    """The patches of the beams' samples."""
    return find_patches(beams.points, beams.directions, beams.returned, error)


def _compute_noise(sensor: Sensor, camera: CameraNoise) -> Noise:
    wide = _is_wide(sensor)
    spot = 0.0 if wide else sensor.spot_radius
    return Noise(
        surface=float(np.linalg.norm([sensor.range_std, SURFACE_STD, camera.patch, CONE_STD * wide, spot / 5])),
        table=float(np.linalg.norm([sensor.range_std, TABLE_STD, _TABLE_SHARE * camera.patch, spot / 5])),
        edge=float(np.linalg.norm([EDGE_STD, camera.patch, spot / 2])),
        rim=RIM_STD + _RIM_SHARE * camera.patch,
        widening=1.0,
    )


def build_problem(model: CameraModel, scans: Sequence[Scan], prior: AnyPrior, sensor: Sensor) -> RegistrationProblem:
    """The problem of registering scans with a scene's model, which the prior's mean has moved already."""
    scene = model.scene
    pose, camera = scene.base_T_camera, scene.camera
    optics = Optics(
        np.array(pose.rotation, order="C"), np.array(pose.translation),
        float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy), float(sensor.range_max),
    )  # fmt: skip
    table = Table(np.array(scene.table.normal), float(scene.table.offset))
    believed = CorrectionPrior.of(prior)
    cone = make_cone(sensor.beam_half_angle) if _is_wide(sensor) else make_thin_beam()
    target = Target(np.array(scene.centroid), optics, table, model.pixels, model.footprint)
    shared = compute_shared_error(sensor, model.noise)
    beams = collect_beams(scans, shared)
    free_turn = np.zeros(6) if model.free_turn is None else model.free_turn
    return RegistrationProblem(
        beams,
        target,
        _compute_noise(sensor, model.noise),
        cone,
        believed,
        _compute_temperature(float(beams.weights.sum()), _is_wide(sensor), model.noise),
        shared,
        _compute_systematic_covariance(sensor, model.noise, believed, free_turn),
        free_turn,
    )


def _compute_systematic_covariance(
    sensor: Sensor, camera: CameraNoise, prior: CorrectionPrior, free_turn: Array
) -> Array:
    """`RegistrationProblem.systematic_covariance`: that of sensor and camera, and the prior's variance of a free turn.

    That of sensor and camera is in no direction more than a quarter of the prior's. A free turn's is the prior's, given
    the correction's other components.
    """
    excess = max(sensor.range_bias_std**2 - Sensor.range_bias_std**2, 0.0) ** 0.5
    own = float(np.hypot(_CONE_SYSTEMATIC if _is_wide(sensor) else _SYSTEMATIC, excess))
    shift, turn = float(np.hypot(own, _CAMERA_SHARE * camera.patch)), _CAMERA_TURN * camera.patch
    shared = prior.bound(np.diag([turn**2] * 3 + [shift**2] * 3), 0.25)
    information = float(free_turn @ prior.precision @ free_turn)
    if information == 0.0:
        return shared
    return np.asarray(shared + np.outer(free_turn, free_turn) / information, dtype=np.float64)
