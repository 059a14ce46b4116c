"""Rectangles scored by simulated scans: a finger scans the displaced mesh along the perimeter, an engine registers it.

The trials are those of the evaluation protocol: path planned from the prior alone, true mesh and table, the same
distribution of calibration errors. Each trial of each rectangle has a calibration error and a noise of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from pretouch_orchestrator.planning.path import plan_paths
from pretouch_registrar.engines import Engine
from pretouch_registrar.engines.solution import pose_from_correction
from pretouch_registrar.registration import Registrar, Settings

from pretouch.estimate import from_prior, point_error
from pretouch.geometry import Array, Pose
from pretouch.rectangle import RotatedRectangle
from pretouch.scan_prediction import Candidate
from pretouch.session import ScanSettings
from pretouch.trajectory import Trajectory
from pretouch_simulation.finger import Finger
from pretouch_simulation.fingers.ideal import ThinBeam
from pretouch_simulation.labels.view import LabelView
from pretouch_simulation.protocol import draw_offset_about, generator


@dataclass(frozen=True)
class Scoring:
    """How rectangles are scored.

    Attributes:
        trials: of each rectangle.
        seed: of calibration errors and noise.
        registrar: it caches the view's model between trials.
    """

    trials: int = 1
    engine: Engine = Engine.POSTERIOR
    finger: Finger = field(default_factory=ThinBeam)
    seed: int = 0
    registrar: Registrar = field(default_factory=Registrar, repr=False, compare=False)

    @property
    def settings(self) -> Settings:
        return Settings(self.engine, sensor=self.finger.sensor)


def paths_of(view: LabelView, rectangles: Sequence[RotatedRectangle], scoring: Scoring) -> list[Trajectory | None]:
    """The first path of a session along each rectangle's perimeter; None where it never comes over the object."""
    return plan_paths(view.scene, rectangles, from_prior(scoring.settings.prior, view.scene.cloud), ScanSettings())


def predict_errors(view: LabelView, paths: Sequence[Trajectory | None], scoring: Scoring) -> Array:
    """(r,), m: the error that the registrar predicts for each path; without a path, the prior's."""
    settings = scoring.settings
    left = np.full(len(paths), from_prior(settings.prior, view.scene.cloud).expected_error)
    there = [Candidate(path) for path in paths if path is not None]
    predictions = scoring.registrar.predict(view.scene, [], settings, there)
    left[[path is not None for path in paths]] = [whole.expected_error for (whole,) in predictions]
    return left


def score(
    view: LabelView, paths: Sequence[Trajectory | None], wanted: Sequence[int], scoring: Scoring
) -> tuple[Array, Array]:
    """Errors and expected errors (r, t), m, after one scan along each path; NaN for those that are not `wanted`.

    A rectangle without a path leaves the prior's error.
    """
    errors, expected = np.full((2, len(paths), scoring.trials), np.nan)
    for k in wanted:
        for trial in range(scoring.trials):
            errors[k, trial], expected[k, trial] = _run_trial(view, paths[k], scoring, k, trial)
    return errors, expected


def scan_and_register(
    view: LabelView, path: Trajectory | None, truth: Pose, scoring: Scoring, rng: np.random.Generator
) -> tuple[float, float]:
    """Error and expected error, m, after a scan along `path` if `truth` is the true correction; `rng` draws the noise.

    The error is over the object's true points; the expected error is over the points in the client's mask.
    """
    scene, settings = view.scene, scoring.settings
    true_cloud = view.case.cloud
    if path is None:
        return mean_error(true_cloud, truth, Pose.identity()), from_prior(settings.prior, scene.cloud).expected_error
    solution = scoring.registrar.solve(scene, [view.scan(truth, path, scoring.finger, rng)], settings)
    correction = pose_from_correction(solution.x, scene.centroid)
    left, _ = point_error(solution.covariance, correction.apply(scene.cloud), scene.centroid + solution.x[3:])
    return mean_error(true_cloud, truth, correction), left


def mean_error(cloud: Array, truth: Pose, correction: Pose) -> float:
    """m: mean distance of the object's points (n, 3), as corrected, from their true place."""
    return float(np.linalg.norm(truth.apply(cloud) - correction.apply(cloud), axis=1).mean())


def _run_trial(view: LabelView, path: Trajectory | None, scoring: Scoring, k: int, trial: int) -> tuple[float, float]:
    rng = generator("label", scoring.seed, view.case.name, view.case.view, k, trial)
    return scan_and_register(view, path, draw_offset_about(view.scene.centroid, rng), scoring, rng)
