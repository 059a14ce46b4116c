"""`pretouch labels`: generates a dataset of scored rectangles, and shows one."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Annotated

import typer
from pretouch_detector.training.dataset import Dataset
from pretouch_registrar.engines import Engine
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from pretouch.interrupts import INTERRUPTED
from pretouch.results import check_folder
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.finger import FingerModel
from pretouch_simulation.labels.frame_task import frame_tasks
from pretouch_simulation.labels.generation import Kind, Outcome, Recipe, describe
from pretouch_simulation.labels.making import Cluster, find_unlabelled, make
from pretouch_simulation.labels.pictures import save_contact_sheet, save_statistics
from pretouch_simulation.labels.statistics import statistics, table
from pretouch_simulation.labels.task import ViewTask, tasks_of
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.split import compute_mixing_key

_FILE_WIDTH = 140

labels = typer.Typer(help=__doc__, no_args_is_help=True)


@labels.command()
def generate(
    out: Annotated[Path, typer.Option(help="The dataset's folder. What is there already is kept.")],
    meshes: Annotated[
        Path | None, typer.Option(help="Folder of meshes in metres: .ply, .obj, .stl, .off, .glb, .3mf.")
    ] = None,
    made_in_code: Annotated[int, typer.Option(min=0, help="Objects of random sizes made in code.")] = 0,
    frames: Annotated[
        Path | None, typer.Option(help="Folder of depth frames; --kind trials needs neither poses nor meshes.")
    ] = None,
    kind: Annotated[
        Kind, typer.Option(help="scans: the finger scans the displaced mesh. trials: the paper's Algorithm 1.")
    ] = Kind.SCANS,
    engine: Annotated[
        Engine | None, typer.Option(help="How scans are matched.", show_default="posterior; paper for trials")
    ] = None,
    rectangles: Annotated[
        int | None, typer.Option(min=1, help="Of each view.", show_default="40; 1000 for trials")
    ] = None,
    scanned: Annotated[
        int | None, typer.Option(min=1, help="Rectangles that are scanned, of kind scans.", show_default="16")
    ] = None,
    trials: Annotated[
        int | None, typer.Option(min=1, help="Of each rectangle.", show_default="1; 10 for trials")
    ] = None,
    best_only: Annotated[
        bool, typer.Option("--best-only", help="Of kind trials: only the best rectangle's score is wanted.")
    ] = False,
    finger: Annotated[FingerModel, typer.Option(help="The simulated fingertip, of kind scans.")] = FingerModel.IDEAL,
    camera: Annotated[CameraModel, typer.Option(help="The simulated depth camera of meshes.")] = CameraModel.KINECT,
    poses: Annotated[int, typer.Option(min=1, help="Resting poses of each mesh.")] = 2,
    views: Annotated[int, typer.Option(min=1, help="Views of each mesh in each pose.")] = 2,
    seed: Annotated[
        int, typer.Option(help="Fixes views, rectangles, offsets and noise: the labels do not depend on --workers.")
    ] = 0,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; left out: one for each core.")] = None,
    limit: Annotated[
        int | None, typer.Option(min=1, help="Only the first so many views, in an order that mixes the objects.")
    ] = None,
    engine_cluster: Annotated[
        Cluster | None,
        typer.Option(help="Share the work out: RAY_ADDRESS names the cluster, whose nodes see the same folders."),
    ] = None,
) -> None:
    """Label views of meshes, of objects made in code, or of depth frames.

    The same command goes on where it was stopped.
    """
    check_folder(out)
    recipe = replace(_recipe(kind, engine, rectangles, scanned, trials, best_only, finger, seed), camera=camera)
    tasks = _tasks(meshes, made_in_code, frames, poses, views, camera)[:limit]
    dataset = Dataset.create(out, describe(recipe, shlex.join(["pretouch", *sys.argv[1:]])))
    console = Console(stderr=True)
    try:
        failed = _make_with_progress(tasks, recipe, dataset, workers or os.cpu_count() or 1, engine_cluster, console)
    except KeyboardInterrupt:
        kept = len(tasks) - len(find_unlabelled(tasks, dataset))
        console.print(
            f"Interrupted. {kept} of {len(tasks)} views are kept in {out}; the same command goes on.",
            markup=False,
            soft_wrap=True,
        )
        raise typer.Exit(INTERRUPTED) from None
    _report(tasks, failed, dataset)
    if len(failed) == len(tasks) or any(outcome.defect for outcome in failed):
        raise typer.Exit(1)


def _recipe(
    kind: Kind,
    engine: Engine | None,
    rectangles: int | None,
    scanned: int | None,
    trials: int | None,
    best_only: bool,
    finger: FingerModel,
    seed: int,
) -> Recipe:
    if kind is Kind.TRIALS:
        return Recipe(
            kind, engine or Engine.PAPER, rectangles or 1000, scanned or 0, trials or 10, best_only, finger, seed
        )
    count = rectangles or Recipe.rectangles
    return Recipe(
        kind,
        engine or Recipe.engine,
        count,
        scanned or min(Recipe.scanned, count),
        trials or Recipe.trials,
        best_only,
        finger,
        seed,
    )


def _tasks(
    meshes: Path | None,
    made_in_code: int,
    frames: Path | None,
    poses: int,
    views: int,
    camera: CameraModel,
) -> list[ViewTask]:
    """Meshes in an order that mixes their sources, then what is made in code, then frames."""
    files = sorted(meshes_in(meshes), key=lambda path: compute_mixing_key(path.stem)) if meshes else []
    seen: list[ViewTask] = [*frame_tasks(frames)] if frames else []
    return [*tasks_of(files, made_in_code, poses, views, camera), *seen] if files or made_in_code or not seen else seen


def _make_with_progress(
    tasks: Sequence[ViewTask],
    recipe: Recipe,
    dataset: Dataset,
    workers: int,
    cluster: Cluster | None,
    console: Console,
) -> list[Outcome]:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=console) as progress:
        there = len(tasks) - len(find_unlabelled(tasks, dataset))
        bar = progress.add_task("views", total=len(tasks), completed=there)
        return make(tasks, recipe, dataset, workers, cluster, lambda outcome: progress.advance(bar))


def _report(tasks: Sequence[ViewTask], failed: Sequence[Outcome], dataset: Dataset) -> None:
    console = _console()
    for problem, outcomes in groupby(sorted(failed, key=lambda one: one.problem), key=lambda one: one.problem):
        first, *others = (outcome.name for outcome in outcomes)
        more = f" and {len(others)} more" if others else ""
        console.print(f"{first}{more}: {problem}", style="yellow", markup=False, soft_wrap=True)
    done = len(tasks) - len(failed)
    console.print(f"{done} of {len(tasks)} views are labelled in {dataset.folder}.", markup=False, soft_wrap=True)


def _console() -> Console:
    known = sys.stdout.isatty() or "COLUMNS" in os.environ
    return Console(width=None if known else _FILE_WIDTH)


@labels.command()
def show(
    folder: Annotated[Path, typer.Argument(help="The dataset's folder.", metavar="DIR")],
    out: Annotated[Path | None, typer.Option(help="Folder for the pictures.", show_default="DIR")] = None,
) -> None:
    """Draw what is in a dataset: a page of statistics and a contact sheet; and print a table."""
    dataset = Dataset(folder)
    views = statistics(dataset)
    target = out or folder
    check_folder(target)
    sheet, page = target / "contact_sheet.png", target / "statistics.png"
    recipe = ", ".join(f"{name} {value}" for name, value in dataset.description.get("recipe", {}).items())
    save_statistics(views, f"{len(views)} views: {recipe}", page)
    shown = save_contact_sheet(dataset, sheet)
    console = _console()
    console.print(table(views))
    console.print(f"Statistics: {page}; {len(shown)} views: {sheet}.", markup=False, soft_wrap=True)
