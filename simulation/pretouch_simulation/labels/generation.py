"""Views labelled one after the other, by any number of workers, each in a file of its own."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from pretouch_detector.proposals.random import candidates
from pretouch_detector.training import trials
from pretouch_detector.training.dataset import Dataset, Example, write
from pretouch_registrar.engines import Engine
from pretouch_registrar.engines.batch import Matching

from pretouch.errors import InvalidInput
from pretouch.geometry import Array
from pretouch_simulation.finger import FingerModel
from pretouch_simulation.labels import scans
from pretouch_simulation.labels.task import Task
from pretouch_simulation.labels.view import LabelView, view_of
from pretouch_simulation.protocol import generator

MATCHINGS = {Engine.PAPER: Matching.PAPER, Engine.MAP: Matching.MAP, Engine.PCL: Matching.PCL}
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
        scanned: rectangles of a view whose trials are made, of `SCANS`: half of them those that the registrar foretells
            to be best, the others drawn from the rest.
        best_only: only the winner's trials are all made, of `TRIALS`.
        finger: of `SCANS`.
    """

    kind: Kind = Kind.SCANS
    engine: Engine = Engine.POSTERIOR
    rectangles: int = 40
    scanned: int = 16
    trials: int = 1
    best_only: bool = False
    finger: FingerModel = FingerModel.IDEAL
    seed: int = 0

    def __post_init__(self) -> None:
        if self.kind is Kind.TRIALS and self.engine not in MATCHINGS:
            raise InvalidInput(
                f"Algorithm 1 does not match by {self.engine}.",
                f"Choose one of {', '.join(MATCHINGS)}, or --kind scans.",
            )


@dataclass(frozen=True)
class Outcome:
    """Of one view: its name; and why it has no labels, empty where it has."""

    name: str
    problem: str = field(default="")


def label(task: Task, recipe: Recipe, folder: Path, threads: int | None = 1) -> None:
    """Makes the view and its labels, and writes their file.

    Raises:
        PretouchError: the object cannot be shown, or none of it can be scanned.
    """
    view = view_of(task.case(recipe.seed))
    rng = generator("rectangles", recipe.seed, task.name)
    if recipe.kind is Kind.TRIALS:
        settings = trials.Settings(recipe.rectangles, recipe.trials, MATCHINGS[recipe.engine], recipe.best_only)
        rectangles, scores = trials.label(view.scene, settings, rng, threads)
        expected, foreseen = np.full_like(scores, np.nan), np.full(len(scores), np.nan)
    else:
        rectangles, scores, expected, foreseen = _scanned(view, recipe, rng)
    provenance: dict[str, Any] = {
        "source": task.source.name if isinstance(task.source, Path) else "made in code",
        "pose": task.pose,
        "view": task.view,
        "first_pixel": list(view.origin),
    }
    example = Example(task.name, task.object, view.scene, rectangles, scores, expected, foreseen, provenance)
    write(Dataset(folder).path(task.side, task.name), example)


def describe(recipe: Recipe, command: str) -> dict[str, Any]:
    """What `dataset.json` says."""
    return {"recipe": asdict(recipe), "command": command}


def _scanned(view: LabelView, recipe: Recipe, rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    rectangles = candidates(view.scene, recipe.rectangles, rng)
    scoring = scans.Scoring(recipe.trials, recipe.engine, recipe.finger, recipe.seed)
    paths = scans.paths_of(view, rectangles, scoring)
    if not any(paths):
        raise InvalidInput("No rectangle of the view can be scanned.", "Leave the object out.")
    foreseen = scans.foreseen(view, paths, scoring)
    order = np.argsort(foreseen, kind="stable")
    best = order[: recipe.scanned // 2]
    rest = rng.permutation(order[len(best) :])[: recipe.scanned - len(best)]
    errors, expected = scans.score(view, paths, [*best.tolist(), *rest.tolist()], scoring)
    return np.array([rectangle.as_list() for rectangle in rectangles]), errors, expected, foreseen
