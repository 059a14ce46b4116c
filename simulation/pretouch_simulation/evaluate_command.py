"""`pretouch evaluate`: the evaluation protocol on a folder of meshes."""

from __future__ import annotations

import json
import os
import shlex
import signal
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from pretouch_registrar.engines import Engine
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from pretouch.session import Planner, Proposer
from pretouch_simulation.evaluation import NEVER_CONVERGED, Protocol, Run
from pretouch_simulation.evaluation_pool import PartialResults, Task, run_all
from pretouch_simulation.evaluation_table import by_object, by_scan
from pretouch_simulation.finger import FingerModel
from pretouch_simulation.mesh_folder import meshes_in

_INTERRUPTED = 130
_FILE_WIDTH = 140


def evaluate(
    meshes: Annotated[Path, typer.Option(help="Folder of PLY, OBJ or STL files, in metres.")],
    out: Annotated[Path, typer.Option("--json", help="Where the rows go; OUT.partial keeps those of a stopped run.")],
    views: Annotated[int, typer.Option(min=1, help="Views of each mesh.")] = 3,
    scans: Annotated[int, typer.Option(min=1, max=1000, help="Scans of each view.")] = 5,
    proposer: Annotated[Proposer | None, typer.Option(help="Left out: the best one that is ready.")] = None,
    engine: Annotated[Engine, typer.Option(help="How scans are matched.")] = Engine.POSTERIOR,
    planner: Annotated[Planner, typer.Option(help="How the next region is chosen.")] = Planner.INFORMATION,
    sensor: Annotated[FingerModel, typer.Option(help="The simulated fingertip.")] = FingerModel.IDEAL,
    seed: Annotated[int, typer.Option(help="Another seed gives other views and offsets.")] = 0,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; left out: one for each core.")] = None,
    only: Annotated[
        list[str] | None, typer.Option(help="Only this mesh (file name without suffix); repeatable.")
    ] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Only the first so many meshes.")] = None,
    tolerance: Annotated[
        float | None, typer.Option(min=0.0, help="Stop a session at this error, m; left out: make all scans.")
    ] = None,
    paper_setting: Annotated[
        bool, typer.Option("--paper-setting", help="As the paper tested: scans cut from the camera's own cloud.")
    ] = False,
) -> None:
    """Score the whole loop on simulated views of a folder of meshes."""
    console = Console(stderr=True)
    protocol = Protocol(
        scans=scans,
        proposer=proposer,
        engine=Engine.PAPER if paper_setting else engine,
        planner=Planner.CONFIDENCE if paper_setting else planner,
        sensor=FingerModel.IDEAL if paper_setting else sensor,
        seed=seed,
        tolerance=tolerance or NEVER_CONVERGED,
        paper_setting=paper_setting,
    )
    tasks = [(path, view) for path in meshes_in(meshes, only or (), limit) for view in range(views)]
    kept = PartialResults(out, protocol)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        runs = _run(tasks, protocol, workers or os.cpu_count() or 1, kept, console)
    except KeyboardInterrupt:
        console.print(
            f"Interrupted. {len(kept.runs)} of {len(tasks)} runs are kept in {kept.path}; the same command goes on."
        )
        raise typer.Exit(_INTERRUPTED) from None
    _write(out, shlex.join(["pretouch", *sys.argv[1:]]), seed, runs)
    kept.remove()
    _report(runs, scans, out)
    if any(run.problem for run in runs):
        raise typer.Exit(1)


def _run(tasks: Sequence[Task], protocol: Protocol, workers: int, kept: PartialResults, console: Console) -> list[Run]:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=console) as progress:
        bar = progress.add_task("runs", total=len(tasks), completed=sum((p.stem, v) in kept.runs for p, v in tasks))
        return run_all(tasks, protocol, workers, kept, lambda run: progress.advance(bar))


def _write(out: Path, command: str, seed: int, runs: Sequence[Run]) -> None:
    rows: list[dict[str, Any]] = [asdict(row) for run in runs for row in run.rows]
    draft = out.with_name(out.name + ".new")
    draft.write_text(json.dumps({"command": command, "seed": seed, "rows": rows}, indent=1) + "\n")
    draft.replace(out)


def _report(runs: Sequence[Run], scans: int, out: Path) -> None:
    console = Console(width=None if sys.stdout.isatty() else _FILE_WIDTH)
    console.print(by_object(runs, scans))
    console.print(by_scan(runs, scans))
    for run in runs:
        if run.problem:
            console.print(
                f"{run.mesh}, view {run.view} failed: {run.problem}", style="red", markup=False, soft_wrap=True
            )
        elif not run.rows:
            console.print(f"{run.mesh}, view {run.view}: no scan could be planned; it has no row.", style="yellow")
    console.print(f"The rows are in {out}.", markup=False, soft_wrap=True)
