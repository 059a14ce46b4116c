"""Registers scans with a scene: the estimate, and the predicted error after further scans."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pretouch.cancellation import check_cancelled
from pretouch.errors import TooLarge, UnknownScene
from pretouch.estimate import MIN_FIT, Estimate, Mode, from_prior, point_error, select_arms
from pretouch.expected_error import compute_expected_errors
from pretouch.geometry import Array, Pose
from pretouch.prior import AnyPrior, PosePrior, Prior
from pretouch.scan_prediction import Candidate, Prediction, check_pieces
from pretouch.scene import Scene
from pretouch.tof import Scan, Sensor
from pretouch.tracing import span
from pretouch_registrar.beam_selection import select_beams
from pretouch_registrar.downsampling import downsample_scene
from pretouch_registrar.engines import Engine, camera_model, solve
from pretouch_registrar.engines.beam_width import ASSUMED_HALF_ANGLE, is_wide_beam
from pretouch_registrar.engines.camera_model import CameraModel
from pretouch_registrar.engines.goodness_of_fit import compute_p_value
from pretouch_registrar.engines.inliers import classify_samples
from pretouch_registrar.engines.prior import CorrectionPrior
from pretouch_registrar.engines.registration_problem import (
    RegistrationProblem,
    build_problem,
    find_beam_patches,
)
from pretouch_registrar.engines.resources import Resources
from pretouch_registrar.engines.solution import Solution, pose_from_correction
from pretouch_registrar.lru_cache import LruCache
from pretouch_registrar.observability import find_weak_directions
from pretouch_registrar.prediction import count_truths, predict_candidate

MAX_SAMPLES = 400_000
"""Samples of all scans of one call."""
CACHE_BYTES = 768 * 2**20
"""Memory for recent results, unless a registrar is told otherwise: for hundreds of scenes of a usual size."""
_SCENES, _MODELS, _SOLUTIONS = 0.2, 0.4, 0.4
"""Shares of it for scenes, their models, and solutions, each of which keeps its model."""
_SCENE_PIXEL, _MODEL_PIXEL, _MODEL_CELL, _SAMPLE = 32, 112, 60, 72
"""Bytes that a pixel takes of a scene and of its model, scene included; a cell of its footprint; a sample."""


@dataclass(frozen=True)
class Settings:
    """The engine, the prior and the sensor of a registration."""

    engine: Engine = Engine.POSTERIOR
    prior: AnyPrior = field(default_factory=Prior)
    sensor: Sensor = field(default_factory=Sensor)

    @property
    def digest(self) -> bytes:
        """(16,): equal for equal settings, to the bit."""
        prior = self.prior
        numbers = np.concatenate([prior.mean.matrix.ravel(), prior.covariance.ravel()])
        text = f"{self.engine} {type(prior).__name__} {self.sensor}"
        return hashlib.blake2b(text.encode() + numbers.tobytes(), digest_size=16).digest()


class Registrar:
    """Registers scans with scenes. It is thread-safe, and made once in a process.

    It caches the camera models of recent scenes by content, what engines derived from them, and recent solutions. It
    owns as many threads as there are processors.
    """

    def __init__(self, cache_bytes: int = CACHE_BYTES) -> None:
        self.cache_bytes = cache_bytes
        self._scenes: LruCache[bytes, Scene] = LruCache(int(_SCENES * cache_bytes), _weigh_scene)
        self._models: LruCache[bytes, CameraModel] = LruCache(int(_MODELS * cache_bytes), _weigh_model)
        self._solutions: LruCache[bytes, tuple[RegistrationProblem, Solution]] = LruCache(
            int(_SOLUTIONS * cache_bytes), _weigh_solution
        )
        self._resources = Resources()

    def remember(self, scene: Scene) -> Scene:
        """Keeps the scene for `recall`, under the hash of its content as it is; returns it as it is registered.

        Raises:
            InvalidInput: an object that is too large.
        """
        digest = scene.digest
        known = self._scenes.get(digest)
        if known is None:
            known = downsample_scene(scene)
            for each in {digest, known.digest}:
                self._scenes.put(each, known)
        return known

    def recall(self, digest: bytes) -> Scene:
        """The scene of a content hash (32,), as it is registered.

        Raises:
            UnknownScene: it was never sent, or long ago.
        """
        if (scene := self._scenes.get(digest)) is None:
            raise UnknownScene("The registrar keeps no scene of this digest.", "Send the scene itself.")
        return scene

    def register(self, scene: Scene, scans: Sequence[Scan], settings: Settings, at: Array | None = None) -> Estimate:
        """The estimate from all scans; their order does not matter.

        Args:
            at: (k, 3), m, in base, as the camera puts them: where the error counts; None: the object's visible points.

        Raises:
            InvalidInput: an object that is too large.
            TooLarge: more than MAX_SAMPLES samples.
        """
        given = self.remember(scene)
        scene = self._move(given, settings.prior)
        ordered = _select_scans(scene, scans, settings)
        if not ordered:
            return from_prior(settings.prior, given.cloud, at)
        estimate = replace(
            _make_estimate(scene, *self._solve_cached(scene, ordered, settings), _move_points(at, settings.prior)),
            engine=settings.engine.value,
        )
        return estimate if scene is given else _before(estimate, settings.prior.mean, given.centroid)

    def solve(self, scene: Scene, scans: Sequence[Scan], settings: Settings) -> Solution:
        """The engine's own solution behind `register`, with its other modes; about the prior's mean."""
        scene = self._move(self.remember(scene), settings.prior)
        return self._solve_cached(scene, _select_scans(scene, scans, settings), settings)[1]

    def predict(
        self,
        scene: Scene,
        scans: Sequence[Scan],
        settings: Settings,
        candidates: Sequence[Candidate],
        at: Array | None = None,
    ) -> list[list[Prediction]]:
        """For each candidate, what a scan of each of its pieces would leave and return, given the scans so far.

        Engines `paper` and `pcl` cannot predict errors: they return the present expected error for each. `at` as in
        `register`.

        Raises:
            InvalidInput: more than MAX_PIECES pieces, or an object that is too large.
            TooLarge: more than MAX_SAMPLES samples.
        """
        check_pieces(candidates)
        scene = self._move(self.remember(scene), settings.prior)
        at = _move_points(at, settings.prior)
        ordered = _select_scans(scene, scans, settings)
        problem, solution = self._solve_cached(scene, ordered, settings)
        truths = count_truths(problem, sum(len(candidate.pieces) for candidate in candidates))
        earlier = find_beam_patches(problem.beams, problem.shared)
        outcomes = self._resources.map(
            lambda each: predict_candidate(
                problem, solution.x, solution.covariance, each, settings.sensor, earlier, truths
            ),
            candidates,
        )
        if not outcomes:
            return []
        points = pose_from_correction(solution.x, scene.centroid).apply(scene.cloud if at is None else at)
        arms = select_arms(points, scene.centroid + solution.x[3:])
        errors = compute_expected_errors([left for each in outcomes for left, _ in each], arms)
        if settings.engine in (Engine.PAPER, Engine.PCL):
            errors[:] = _make_estimate(scene, problem, solution, at).expected_error
        by_piece = iter(errors.tolist())
        return [[Prediction(next(by_piece), returns) for _, returns in each] for each in outcomes]

    def _move(self, scene: Scene, prior: AnyPrior) -> Scene:
        """The scene where the prior expects it: corrections of it have zero mean.

        Raises:
            InvalidInput: the prior's mean moves the object too far.
        """
        prior.check_mean(scene.centroid)
        if prior.mean.is_close(Pose.identity(), 0.0):
            return scene
        key = scene.digest + prior.mean.matrix.tobytes()
        return self._scenes.get_or_make(key, lambda: scene.moved(prior.mean))

    def _solve_cached(
        self, scene: Scene, scans: Sequence[Scan], settings: Settings
    ) -> tuple[RegistrationProblem, Solution]:
        """The problem and its solution, cached because `predict` follows `register` on the same scans."""
        key = scene.digest + b"".join(_hash_scan(scan) for scan in scans) + settings.digest
        return self._solutions.get_or_make(key, lambda: self._solve(scene, scans, settings))

    def _solve(self, scene: Scene, scans: Sequence[Scan], settings: Settings) -> tuple[RegistrationProblem, Solution]:
        """The solution under the prior, or under its fallback if that is too far away for the prior to be right.

        A stated prior may be wrong, and then holds the solution in a place that robust costs explain well enough: only
        a solution without it tells.
        """
        model = self._models.get_or_make(scene.digest, lambda: camera_model.build(scene))
        check_cancelled()
        prior = settings.prior
        if isinstance(prior, PosePrior) and scans:
            wide, found = self._solve_with(model, scans, replace(settings, prior=prior.fallback))
            correction = pose_from_correction(found.x, scene.centroid)
            about = PosePrior(Pose.identity(), prior.covariance)
            if found.fit >= MIN_FIT and about.is_contradicted_by(correction, scene.centroid, found.covariance):
                return wide, found
        return self._solve_with(model, scans, settings)

    def _solve_with(
        self, model: CameraModel, scans: Sequence[Scan], settings: Settings
    ) -> tuple[RegistrationProblem, Solution]:
        """The solution under the prior alone."""
        problem = build_problem(model, scans, settings.prior, settings.sensor)
        check_cancelled()
        if not scans:
            return problem, Solution(np.zeros(6), settings.prior.covariance)
        try:
            with span("solve", {"pretouch.engine": settings.engine.value, "pretouch.scans": len(scans)}):
                solution = solve(settings.engine, problem, model, self._resources)
        except np.linalg.LinAlgError:  # a scene that no camera sees, whose numbers determine nothing
            solution = Solution(np.zeros(6), settings.prior.covariance)
        if settings.engine is Engine.POSTERIOR and settings.sensor.beam_half_angle == 0.0:
            assumed = replace(settings.sensor, beam_half_angle=ASSUMED_HALF_ANGLE)
            wide = build_problem(model, scans, settings.prior, assumed)
            if is_wide_beam(solution.x, problem, wide, self._resources):
                problem, solution = wide, solve(settings.engine, wide, model, self._resources)
        fit = compute_p_value(classify_samples(solution.x, problem), problem, [len(scan) for scan in scans])
        return problem, _mix_with_prior(replace(solution, fit=fit), problem.prior)


def _mix_with_prior(solution: Solution, prior: CorrectionPrior) -> Solution:
    """The solution, mixed with the prior if it does not explain the samples.

    Below a p-value of MIN_FIT the prior's share grows as the fit gets worse. If the solution contradicts the prior,
    one of the two is wrong, and the prior is returned. In no direction is the covariance wider than the prior's.
    """
    share = 1.0 if prior.is_contradicted_by(solution.x) else max(0.0, 1.0 - solution.fit / MIN_FIT)
    mean = (1.0 - share) * solution.x
    between = share * (1.0 - share) * np.outer(solution.x, solution.x)
    covariance = (1.0 - share) * solution.covariance + share * prior.covariance + between
    return replace(solution, x=mean, covariance=prior.bound(covariance))


def _select_scans(scene: Scene, scans: Sequence[Scan], settings: Settings) -> list[Scan]:
    """The scans' beams near the object, in an order that does not depend on theirs; without empty or equal scans."""
    check_samples(scans)
    near = (select_beams(scene, scan, settings.prior.fallback, settings.sensor) for scan in scans)
    return [scan for _, scan in sorted({_hash_scan(scan): scan for scan in near if len(scan)}.items())]


def check_samples(scans: Sequence[Scan]) -> None:
    """Raises TooLarge if the scans have more than MAX_SAMPLES samples together."""
    count = sum(len(scan) for scan in scans)
    if count > MAX_SAMPLES:
        raise TooLarge(f"The scans have {count} samples; the limit is {MAX_SAMPLES}.", "Thin out the scans.")


def _weigh_scene(scene: Scene) -> int:
    return _SCENE_PIXEL * scene.mask.size


def _weigh_model(model: CameraModel) -> int:
    return _MODEL_PIXEL * model.scene.mask.size + _MODEL_CELL * model.footprint.top.size


def _weigh_solution(solved: tuple[RegistrationProblem, Solution]) -> int:
    problem = solved[0]
    target = _MODEL_PIXEL * problem.target.pixels.kinds.size + _MODEL_CELL * problem.target.footprint.top.size
    return target + _SAMPLE * len(problem.beams.weights)


def _hash_scan(scan: Scan) -> bytes:
    arrays = (scan.origins, scan.directions, scan.ranges)
    return hashlib.blake2b(b"".join(array.tobytes() for array in arrays), digest_size=16).digest()


def _move_points(at: Array | None, prior: AnyPrior) -> Array | None:
    """Points (k, 3), m, that move with the scene."""
    return None if at is None else prior.mean.apply(at)


def _before(estimate: Estimate, mean: Pose, centroid: Array) -> Estimate:
    """The estimate of a scene that `mean` has moved, as one of the scene before; `centroid` (3,), m, is that one's.

    The covariance stays: the error at the moved centroid is that of the composed correction at the original one.
    """
    return replace(
        estimate,
        base_T_correction=estimate.base_T_correction @ mean,
        centroid=centroid,
        modes=tuple(Mode(mode.base_T_correction @ mean, mode.weight) for mode in estimate.modes),
    )


def _make_estimate(scene: Scene, problem: RegistrationProblem, solution: Solution, at: Array | None) -> Estimate:
    x, covariance = solution.x, solution.covariance
    correction = pose_from_correction(x, scene.centroid)
    cloud = correction.apply(scene.cloud)
    counted = None if at is None else correction.apply(at)
    expected, quantile = point_error(covariance, cloud if counted is None else counted, scene.centroid + x[3:])
    classification = classify_samples(x, problem)
    inlier = classification.inlier
    modes = (x, *solution.other_modes)
    return Estimate(
        base_T_correction=correction,
        centroid=scene.centroid,
        covariance=covariance,
        expected_error=expected,
        error_quantile=float(quantile[0]),
        unobservable=find_weak_directions(covariance, cloud, scene.table.normal, counted),
        inliers=int(inlier.sum()),
        samples=len(problem.beams.weights),
        rmse=float(np.sqrt(np.mean(classification.residuals[inlier] ** 2))) if inlier.any() else 0.0,
        modes=tuple(
            Mode(pose_from_correction(mode, scene.centroid), float(weight))
            for mode, weight in zip(modes, solution.mode_weights, strict=True)
        ),
        fit=solution.fit,
    )
