"""From a scene and its scans to an estimate, and to what a further scan would tell."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from pretouch.estimate import Estimate, Prior, from_prior, point_error
from pretouch.geometry import Array, Pose, rotation_from_vector
from pretouch.scene import Scene
from pretouch.tof import Scan, Sensor
from pretouch.trajectory import Trajectory
from pretouch_registrar.engines import camera_model, map, paper
from pretouch_registrar.engines.agreement import Problem, pose_problem, sample_residuals
from pretouch_registrar.engines.camera_model import CameraModel
from pretouch_registrar.prediction import predicted_information
from pretouch_registrar.recent import Recent
from pretouch_registrar.weak import weak_directions

_THREADS = 2
"""Threads that predict candidates: the kernels run without Python's lock."""
_OBJECT_HEIGHT = 0.01
"""m: engine `paper` takes returns higher than this above the table to be the object's."""


class Engine(StrEnum):
    """How scans are matched; see the modules in `engines`."""

    MAP = "map"
    PAPER = "paper"


@dataclass(frozen=True)
class Settings:
    """What the registrar needs to know besides the scene and the scans."""

    engine: Engine = Engine.MAP
    prior: Prior = field(default_factory=Prior)
    sensor: Sensor = field(default_factory=Sensor)


def _content(scene: Scene) -> bytes:
    digest = hashlib.blake2b(scene.depth.metres.tobytes())
    digest.update(np.packbits(scene.mask).tobytes())
    c, table = scene.camera, scene.table
    numbers = [*scene.depth.metres.shape, c.fx, c.fy, c.cx, c.cy, *scene.base_T_camera.matrix.ravel()]
    digest.update(np.array([*numbers, *table.normal, table.offset], dtype=np.float64).tobytes())
    return digest.digest()


_models: Recent[bytes, CameraModel] = Recent(32)
_solutions: Recent[bytes, tuple[Problem, Array, Array]] = Recent(64)


def register(scene: Scene, scans: Sequence[Scan], settings: Settings) -> Estimate:
    """The estimate from all scans, in whatever order they came."""
    ordered = sorted((scan for scan in scans if len(scan)), key=_scan_key)
    if not ordered:
        return from_prior(settings.prior, scene.cloud)
    if settings.engine is Engine.PAPER:
        return _register_paper(scene, ordered, settings)
    problem, x, covariance = _solved(scene, ordered, settings)
    return _estimate(scene, problem, x, covariance)


def predict(scene: Scene, scans: Sequence[Scan], settings: Settings, candidates: Sequence[Trajectory]) -> list[float]:
    """m: the expected error after each candidate scan, given the scans so far.

    Engine `paper` cannot tell: it answers the present expected error for each.
    """
    ordered = sorted((scan for scan in scans if len(scan)), key=_scan_key)
    if settings.engine is Engine.PAPER:
        return [register(scene, ordered, settings).expected_error] * len(candidates)
    problem, x, covariance = _solved(scene, ordered, settings)
    present = np.linalg.inv(covariance)
    cloud = _correction(scene, x).apply(scene.cloud)
    centroid = scene.centroid + x[3:]

    def expected(candidate: Trajectory) -> float:
        gained = predicted_information(problem, x, covariance, candidate, settings.sensor)
        return point_error(np.linalg.inv(present + gained), cloud, centroid)[0]

    with ThreadPoolExecutor(_THREADS) as pool:
        return list(pool.map(expected, candidates))


def _solved(scene: Scene, scans: Sequence[Scan], settings: Settings) -> tuple[Problem, Array, Array]:
    """The problem, its best correction x (6,) and covariance (6, 6); recent ones are kept, since `predict` follows
    `register` on the same scans."""
    key = _content(scene) + b"".join(_scan_key(scan) for scan in scans) + repr(settings).encode()
    return _solutions.get(key, lambda: _solve(scene, scans, settings))


def _solve(scene: Scene, scans: Sequence[Scan], settings: Settings) -> tuple[Problem, Array, Array]:
    model = _models.get(_content(scene), lambda: camera_model.build(scene))
    problem = pose_problem(model, scans, settings.prior, settings.sensor)
    if not scans:
        return problem, np.zeros(6), settings.prior.covariance()
    return problem, *map.solve(problem)


def _scan_key(scan: Scan) -> bytes:
    return scan.origins.tobytes() + scan.ranges.tobytes()


def _correction(scene: Scene, x: Array) -> Pose:
    """`base_T_correction` of x (6,): p -> exp(w) (p - c) + c + d."""
    rotation = rotation_from_vector(x[:3])
    return Pose.of(rotation, scene.centroid + x[3:] - rotation @ scene.centroid)


def _estimate(scene: Scene, problem: Problem, x: Array, covariance: Array) -> Estimate:
    correction = _correction(scene, x)
    expected, quantile = point_error(covariance, correction.apply(scene.cloud), scene.centroid + x[3:])
    residuals, inlier = sample_residuals(x, *problem.arguments())
    return Estimate(
        base_T_correction=correction,
        centroid=scene.centroid,
        covariance=covariance,
        expected_error=expected,
        error_quantile=float(quantile[0]),
        unobservable=weak_directions(covariance, scene.radius, scene.table.normal),
        inliers=int(inlier.sum()),
        samples=len(problem.beams),
        rmse=float(np.sqrt(np.mean(residuals[inlier] ** 2))) if inlier.any() else 0.0,
    )


def _register_paper(scene: Scene, scans: Sequence[Scan], settings: Settings) -> Estimate:
    prior = from_prior(settings.prior, scene.cloud)
    scan = Scan.concatenate(list(scans))
    points = scan.points()
    source = points[scene.table.height(points) > _OBJECT_HEIGHT]
    scene_T_base = paper.align(source, scene.cloud) if len(source) else None
    if scene_T_base is None:
        return prior
    correction = scene_T_base.inverse()
    covariance = settings.prior.covariance()
    expected, quantile = point_error(covariance, correction.apply(scene.cloud), correction.apply(scene.centroid))
    distance = np.sqrt(((scene_T_base.apply(source)[:, None] - scene.cloud[None, ::8]) ** 2).sum(axis=2).min(axis=1))
    inlier = distance < paper.MAX_DISTANCE / 5
    return Estimate(
        base_T_correction=correction,
        centroid=scene.centroid,
        covariance=covariance,
        expected_error=expected,
        error_quantile=float(quantile[0]),
        unobservable=weak_directions(covariance, scene.radius, scene.table.normal),
        inliers=int(inlier.sum()),
        samples=len(scan),
        rmse=float(np.sqrt(np.mean(distance[inlier] ** 2))) if inlier.any() else 0.0,
    )
