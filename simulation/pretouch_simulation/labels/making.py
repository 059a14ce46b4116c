"""Labels the missing views of a dataset, in processes on one machine or on a cluster."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Generator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, suppress
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from pretouch_detector.training.dataset import Dataset

from pretouch.errors import PretouchError, Unavailable
from pretouch_simulation.labels.cluster import run_on_ray
from pretouch_simulation.labels.generation import Outcome, Recipe, label, try_to_label
from pretouch_simulation.labels.task import Task, ViewTask
from pretouch_simulation.workers import run_in_workers


class Cluster(StrEnum):
    """The cluster that does the work instead of this machine."""

    RAY = "ray"


def find_unlabelled(tasks: Sequence[ViewTask], dataset: Dataset) -> list[ViewTask]:
    """The tasks that have no file yet."""
    return [task for task in tasks if not dataset.path(task.side, task.name).exists()]


def make(
    tasks: Sequence[ViewTask],
    recipe: Recipe,
    dataset: Dataset,
    workers: int,
    cluster: Cluster | None,
    done: Callable[[Outcome], None],
) -> list[Outcome]:
    """Labels those of `tasks` that have no file yet, calling `done` after each; the files do not depend on `workers`.

    Returns:
        Those that failed, in the order of `tasks`.

    Raises:
        Unavailable: a worker was ended from outside, or the cluster cannot be used.
        KeyboardInterrupt: what was done by then is in the dataset.
    """
    wanted = find_unlabelled(tasks, dataset)
    failed: dict[str, Outcome] = {}
    calls = [(task, recipe, dataset.folder) for task in wanted]
    with closing(_label_all(calls, recipe, workers, cluster)) as outcomes:  # closing ends the workers
        for outcome in outcomes:
            if outcome.problem:
                failed[outcome.name] = outcome
            done(outcome)
    return [failed[task.name] for task in wanted if task.name in failed]


def _label_all(
    calls: Sequence[tuple[Any, ...]], recipe: Recipe, workers: int, cluster: Cluster | None
) -> Generator[Outcome, None, None]:
    if cluster is Cluster.RAY:
        yield from run_on_ray(try_to_label, calls, workers)
        return
    try:
        yield from run_in_workers(try_to_label, calls, workers, warm_up, (recipe,))
    except BrokenProcessPool as error:
        raise Unavailable(
            "A worker process was ended from outside, perhaps for want of memory.",
            "Start the same command again: it goes on. Give fewer --workers if memory was short.",
        ) from error


def warm_up(recipe: Recipe) -> None:
    """Compiles and loads in advance what the first view needs."""
    small = replace(recipe, rectangles=2, trials=1, scanned=min(recipe.scanned, 1))
    with tempfile.TemporaryDirectory() as folder, suppress(PretouchError):
        Dataset.create(Path(folder), {})
        label(Task(0, 0, 0), small, Path(folder))
