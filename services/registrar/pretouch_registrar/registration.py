"""From a scene and its scans to an estimate, and to what a further scan would tell."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pretouch.estimate import Estimate, Mode, Prior, from_prior, point_error
from pretouch.geometry import Array
from pretouch.scene import Scene
from pretouch.tof import Scan, Sensor
from pretouch.trajectory import Trajectory
from pretouch_registrar.coarse import coarse
from pretouch_registrar.engines import Engine, camera_model, solve
from pretouch_registrar.engines.beam_width import SUPPOSED_HALF_ANGLE, measures_wide
from pretouch_registrar.engines.camera_model import CameraModel
from pretouch_registrar.engines.goodness_of_fit import p_value
from pretouch_registrar.engines.inliers import judged
from pretouch_registrar.engines.problem import Problem, pose_problem
from pretouch_registrar.engines.resources import Resources
from pretouch_registrar.engines.solution import Solution, pose_of
from pretouch_registrar.evidence import near_object
from pretouch_registrar.observability import weak_directions
from pretouch_registrar.prediction import predicted_covariance
from pretouch_registrar.recent import Recent

_MODELS, _SOLUTIONS = 32, 64
"""Results that a registrar keeps."""
_CONTRADICTION = 2.6
"""Standard deviations of the prior, per axis, beyond which a correction contradicts it."""
_MISFIT = 0.01
"""p-value of the samples under the answer below which the prior comes back, and the answer with it."""


@dataclass(frozen=True)
class Settings:
    """What the registrar needs to know besides the scene and the scans."""

    engine: Engine = Engine.POSTERIOR
    prior: Prior = field(default_factory=Prior)
    sensor: Sensor = field(default_factory=Sensor)


def _content(scene: Scene) -> bytes:
    digest = hashlib.blake2b(scene.depth.metres.tobytes())
    digest.update(np.packbits(scene.mask).tobytes())
    c, table = scene.camera, scene.table
    numbers = [*scene.depth.metres.shape, c.fx, c.fy, c.cx, c.cy, *scene.base_T_camera.matrix.ravel()]
    digest.update(np.array([*numbers, *table.normal, table.offset], dtype=np.float64).tobytes())
    return digest.digest()


class Registrar:
    """Registers scans with scenes, and keeps what makes the next call on the same scene quicker; for any threads.

    Made once a process. It keeps the models of recent scenes by content, what engines made of them, recent solutions,
    and as many threads as there are processors.
    """

    def __init__(self) -> None:
        self._models: Recent[bytes, CameraModel] = Recent(_MODELS)
        self._solutions: Recent[bytes, tuple[Problem, Solution]] = Recent(_SOLUTIONS)
        self._resources = Resources()

    def register(self, scene: Scene, scans: Sequence[Scan], settings: Settings) -> Estimate:
        """The estimate from all scans, in whatever order they came."""
        scene = coarse(scene)
        ordered = _evidence(scene, scans, settings)
        if not ordered:
            return from_prior(settings.prior, scene.cloud)
        return _estimate(scene, *self._solved(scene, ordered, settings))

    def solution_of(self, scene: Scene, scans: Sequence[Scan], settings: Settings) -> Solution:
        """What the engine answers to `register`'s question, with the other corrections that it names, if any."""
        scene = coarse(scene)
        return self._solved(scene, _evidence(scene, scans, settings), settings)[1]

    def predict(
        self, scene: Scene, scans: Sequence[Scan], settings: Settings, candidates: Sequence[Trajectory]
    ) -> list[float]:
        """m: the expected error after each candidate scan, given the scans so far.

        Engines `paper` and `pcl` cannot tell: they answer the present expected error for each.
        """
        scene = coarse(scene)
        ordered = _evidence(scene, scans, settings)
        if settings.engine in (Engine.PAPER, Engine.PCL):
            return [self.register(scene, ordered, settings).expected_error] * len(candidates)
        problem, solution = self._solved(scene, ordered, settings)
        cloud = pose_of(solution.x, scene.centroid).apply(scene.cloud)
        centroid = scene.centroid + solution.x[3:]

        def expected(candidate: Trajectory) -> float:
            left = predicted_covariance(problem, solution.x, solution.covariance, candidate, settings.sensor)
            return point_error(left, cloud, centroid)[0]

        return self._resources.map(expected, candidates)

    def _solved(self, scene: Scene, scans: Sequence[Scan], settings: Settings) -> tuple[Problem, Solution]:
        """The problem and its solution; recent ones are kept, since `predict` follows `register` on the same scans."""
        key = _content(scene) + b"".join(_scan_key(scan) for scan in scans) + repr(settings).encode()
        return self._solutions.get(key, lambda: self._solve(scene, scans, settings))

    def _solve(self, scene: Scene, scans: Sequence[Scan], settings: Settings) -> tuple[Problem, Solution]:
        model = self._models.get(_content(scene), lambda: camera_model.build(scene))
        problem = pose_problem(model, scans, settings.prior, settings.sensor)
        if not scans:
            return problem, Solution(np.zeros(6), settings.prior.covariance())
        solution = solve(settings.engine, problem, model, self._resources)
        if settings.engine is Engine.POSTERIOR and not problem.wide:
            supposed = replace(settings.sensor, beam_half_angle=SUPPOSED_HALF_ANGLE)
            wide = pose_problem(model, scans, settings.prior, supposed)
            if measures_wide(solution.x, problem, wide, self._resources):
                problem, solution = wide, solve(settings.engine, wide, model, self._resources)
        fit = p_value(judged(solution.x, problem), problem, [len(scan) for scan in scans])
        return problem, _doubted(replace(solution, fit=fit), settings.prior)


def _doubted(solution: Solution, prior: Prior) -> Solution:
    """Less sure of an answer that does not explain the samples, and of none more sure than of nothing.

    Below a p-value of _MISFIT the answer is a mixture with the prior: the worse the samples fit, the more of the prior.
    Where the answer lies far beyond the prior one of the two is wrong, and the prior is the answer. Whatever the
    samples, the covariance is not wider than the prior's in any direction.
    """
    sigmas = np.abs(solution.x) / np.sqrt(np.diag(prior.covariance()))
    share = 1.0 if sigmas.max() > _CONTRADICTION else max(0.0, 1.0 - solution.fit / _MISFIT)
    mean = (1.0 - share) * solution.x
    between = share * (1.0 - share) * np.outer(solution.x, solution.x)
    covariance = (1.0 - share) * solution.covariance + share * prior.covariance() + between
    return replace(solution, x=mean, covariance=_bounded(covariance, prior.covariance()))


def _bounded(covariance: Array, bound: Array) -> Array:
    """The covariance (6, 6), nowhere wider than `bound` (6, 6): its eigenvalues, where that is whitened, at most 1."""
    root = np.linalg.cholesky(bound)
    whiten = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(whiten @ covariance @ whiten.T)
    bounded = root @ (vectors * np.minimum(values, 1.0)) @ vectors.T @ root.T
    return np.asarray(0.5 * (bounded + bounded.T), dtype=np.float64)


def _evidence(scene: Scene, scans: Sequence[Scan], settings: Settings) -> list[Scan]:
    """What the scans say of the object, in an order of its own: equal ones count once, those without a beam never."""
    near = (near_object(scene, scan, settings.prior, settings.sensor) for scan in scans)
    return [scan for _, scan in sorted({_scan_key(scan): scan for scan in near if len(scan)}.items())]


def _scan_key(scan: Scan) -> bytes:
    arrays = (scan.origins, scan.directions, scan.ranges)
    return hashlib.blake2b(b"".join(array.tobytes() for array in arrays), digest_size=16).digest()


def _estimate(scene: Scene, problem: Problem, solution: Solution) -> Estimate:
    x, covariance = solution.x, solution.covariance
    correction = pose_of(x, scene.centroid)
    cloud = correction.apply(scene.cloud)
    expected, quantile = point_error(covariance, cloud, scene.centroid + x[3:])
    verdict = judged(x, problem)
    inlier = verdict.agree
    places = (x, *solution.others)
    return Estimate(
        base_T_correction=correction,
        centroid=scene.centroid,
        covariance=covariance,
        expected_error=expected,
        error_quantile=float(quantile[0]),
        unobservable=weak_directions(covariance, cloud, scene.table.normal),
        inliers=int(inlier.sum()),
        samples=len(problem.beams.weights),
        rmse=float(np.sqrt(np.mean(verdict.residuals[inlier] ** 2))) if inlier.any() else 0.0,
        modes=tuple(
            Mode(pose_of(place, scene.centroid), float(share))
            for place, share in zip(places, solution.shares, strict=True)
        ),
        fit=solution.fit,
    )
