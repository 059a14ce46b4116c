"""Labels views, by any number of workers, each into a file of its own."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from pretouch_detector.proposals.random import draw_candidates
from pretouch_detector.training import trials
from pretouch_detector.training.dataset import Dataset, Example, write
from pretouch_registrar.engines import Engine
from pretouch_registrar.engines.label_trials import Matching

from pretouch.errors import InvalidInput, PretouchError
from pretouch.geometry import Array
from pretouch.tof import Sensor
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.finger import Finger, FingerModel, realise
from pretouch_simulation.labels import scans
from pretouch_simulation.labels.task import ViewTask
from pretouch_simulation.labels.view import LabelView
from pretouch_simulation.protocol import generator

MATCHINGS = {Engine.PAPER: Matching.PAPER, Engine.POINT_TO_PLANE: Matching.POINT_TO_PLANE, Engine.PCL: Matching.PCL}
"""The engines whose kernels Algorithm 1 can use."""


class Kind(StrEnum):
    """`TRIALS`: the paper's Algorithm 1. `SCANS`: the finger scans the displaced mesh."""

    TRIALS = "trials"
    SCANS = "scans"


@dataclass(frozen=True)
class Recipe:
    """How views are labelled. It is part of the dataset's description: another recipe is another dataset.

    Attributes:
        rectangles, trials: of each view, and of each rectangle.
        scanned: of `SCANS`: rectangles of a view that are scanned: half of them the best by the registrar's prediction,
            the others drawn from the rest.
        best_only: of `TRIALS`: complete only the winner's trials.
        finger: of `SCANS`; each view has another fingertip of the model.
        camera: of views of meshes; frames have their own.
    """

    kind: Kind = Kind.SCANS
    engine: Engine = Engine.POSTERIOR
    rectangles: int = 40
    scanned: int = 16
    trials: int = 1
    best_only: bool = False
    finger: FingerModel = FingerModel.IDEAL
    seed: int = 0
    camera: CameraModel = CameraModel.KINECT

    def __post_init__(self) -> None:
        if self.kind is Kind.TRIALS and self.engine not in MATCHINGS:
            raise InvalidInput(
                f"Algorithm 1 does not match by {self.engine}.",
                f"Choose one of {', '.join(MATCHINGS)}, or --kind scans.",
            )
        if self.kind is Kind.TRIALS and self.finger is not FingerModel.IDEAL:
            raise InvalidInput("Algorithm 1 knows no finger.", "Leave out --finger, or choose --kind scans.")
        if self.kind is Kind.SCANS and self.best_only:
            raise InvalidInput("Only Algorithm 1 can be pruned.", "Leave out --best-only, or choose --kind trials.")
        if self.kind is Kind.SCANS and not 1 <= self.scanned <= self.rectangles:
            raise InvalidInput(
                f"{self.scanned} of {self.rectangles} rectangles cannot be scanned.",
                "Give --scanned from 1 to --rectangles.",
            )
        if self.rectangles < 1 or self.trials < 1:
            raise InvalidInput(
                f"{self.rectangles} rectangles with {self.trials} trials each score nothing.",
                "Give at least 1 of each.",
            )


@dataclass(frozen=True)
class Outcome:
    """The outcome of one view.

    Attributes:
        problem: why it has no labels, and what to do about it; empty where it has.
        defect: whether the problem is a defect of pretouch.
    """

    name: str
    problem: str = ""
    defect: bool = False


def try_to_label(task: ViewTask, recipe: Recipe, folder: Path) -> Outcome:
    """`label` on one thread; an error becomes part of the outcome, so that other views go on."""
    try:
        label(task, recipe, folder)
    except PretouchError as error:
        return Outcome(task.name, f"{error.detail} {error.remedy}".strip())
    except Exception as error:  # one odd mesh must not stop the labelling of a thousand others
        return Outcome(task.name, f"{type(error).__name__}: {error}", defect=True)
    return Outcome(task.name)


def label(task: ViewTask, recipe: Recipe, folder: Path, threads: int | None = 1) -> None:
    """Renders the view, labels it, and writes its file.

    Raises:
        PretouchError: the object cannot be shown, or none of it can be scanned.
    """
    rng = generator("rectangles", recipe.seed, task.name)
    if recipe.kind is Kind.TRIALS:
        scene, origin = task.scene(recipe.seed)
        settings = trials.Settings(recipe.rectangles, recipe.trials, MATCHINGS[recipe.engine], recipe.best_only)
        rectangles, scores = trials.label_scene(scene, settings, rng, threads)
        expected, predicted, sensor = np.full_like(scores, np.nan), np.full(len(scores), np.nan), Sensor()
    else:
        view = task.load_view(recipe.seed)
        scene, origin = view.scene, view.origin
        finger = realise(recipe.finger, generator("finger-model", recipe.seed, view.case.name, view.case.view))
        rectangles, scores, expected, predicted = _scan_rectangles(view, recipe, finger, rng)
        sensor = finger.sensor
    provenance = {**task.provenance, "first_pixel": list(origin)}
    example = Example(task.name, task.object, scene, sensor, rectangles, scores, expected, predicted, provenance)
    write(Dataset(folder).path(task.side, task.name), example)


def describe(recipe: Recipe, command: str) -> dict[str, Any]:
    """What `dataset.json` says."""
    return {"recipe": asdict(recipe), "command": command}


def _scan_rectangles(
    view: LabelView, recipe: Recipe, finger: Finger, rng: np.random.Generator
) -> tuple[Array, Array, Array, Array]:
    rectangles = draw_candidates(view.scene, recipe.rectangles, rng)
    scoring = scans.Scoring(recipe.trials, recipe.engine, finger, recipe.seed)
    paths = scans.paths_of(view, rectangles, scoring)
    if not any(paths):
        raise InvalidInput("No rectangle of the view can be scanned.", "Leave the object out.")
    predicted = scans.predict_errors(view, paths, scoring)
    order = np.argsort(predicted, kind="stable")
    best = order[: recipe.scanned // 2]
    rest = rng.permutation(order[len(best) :])[: recipe.scanned - len(best)]
    errors, expected = scans.score(view, paths, [*best.tolist(), *rest.tolist()], scoring)
    return np.array([rectangle.as_list() for rectangle in rectangles]), errors, expected, predicted
