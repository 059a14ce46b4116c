"""`pretouch evaluate`: the evaluation protocol on a folder of meshes, or of real frames."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from pretouch_registrar.engines import Engine
from rich.console import Console

from pretouch.errors import InvalidInput
from pretouch.interrupts import INTERRUPTED
from pretouch.results import STANDARD_OUTPUT, check_file, write_json
from pretouch.session import Planner, Proposer, Tolerance
from pretouch_simulation.campaign_command import evaluate_campaigns, read_campaign_options, refuse_beside_campaign
from pretouch_simulation.campaign_world import campaigns
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.evaluation_console import open_console
from pretouch_simulation.evaluation_pool import PartialResults
from pretouch_simulation.evaluation_progress import run_with_progress
from pretouch_simulation.evaluation_protocol import (
    NEVER_CONVERGED,
    Protocol,
    adapt_to_frames,
    adopt_default_budget,
    can_stop_in_time,
)
from pretouch_simulation.evaluation_rows import Run, write_details
from pretouch_simulation.evaluation_summary import group_by_setup
from pretouch_simulation.evaluation_table import (
    convergence_by_scan_table,
    convergence_table,
    honesty_table,
    tabulate_by_object,
    tabulate_by_scan,
)
from pretouch_simulation.evaluation_tasks import MIN_PIXELS, Task, frame_tasks, mesh_tasks
from pretouch_simulation.finger import FingerModel
from pretouch_simulation.frame_folder import frames_in
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.split import Split
from pretouch_simulation.worst_report import WORST, save_worst_runs

_VIEWS, _SCANS, _SEEDS = 3, 5, 3
_ENGINE = "How scans are matched; repeatable, the rows of all go into one file."
_FRAMES = f"Folder of real frames: sessions on every object with over {MIN_PIXELS} pixels. Instead of --meshes."
_STOP = (
    "Whether scans end as soon as the session would converge; assessing that as the robot moves takes several times as "
    "long to compute. Left out: where sessions can converge, with planner information."
)
_TOLERANCE = "Stop a session at this error, m, with default budgets. Left out: on meshes never, on frames at 3 mm."
_CLUTTER = "Two to five other meshes of the folder, of --split's side, stand around each."
_GUARDED = "The robot lifts its tip by a reflex; paths are planned from what is expected, not from the worst case."

_CAMPAIGNS = "Campaigns"
_CAMPAIGN = (
    "Campaigns of so many objects of --meshes in turn, seen by one camera whose calibration is wrong, to --tolerance; "
    "beside them the same without camera.id. --views says how many campaigns."
)
_MOVING = "The camera is elsewhere for each object, as on a wrist."
_RESIDUAL = "What differs from session to session: standard deviations. Left out: 0.002 0.4."
_KNOCK = "The camera is knocked before the object at this position: by how much, at the object."
_DRIFT = "Steps of the camera from one object to the next: standard deviations."
_REPORT = f"Where the {WORST} runs with the largest errors go as reports, one HTML file; they are run once more for it."


def evaluate(
    out: Annotated[
        Path,
        typer.Option(
            "--json",
            help="Where the rows go; OUT.partial keeps those of a stopped run. - is standard output, and keeps none.",
        ),
    ],
    meshes: Annotated[
        Path | None, typer.Option(help="Folder of meshes in metres: .ply, .obj, .stl, .off, .glb, .3mf.")
    ] = None,
    frames: Annotated[Path | None, typer.Option(help=_FRAMES)] = None,
    views: Annotated[int | None, typer.Option(min=1, help=f"Views of each mesh. Left out: {_VIEWS}.")] = None,
    seeds: Annotated[
        int | None, typer.Option(min=1, help=f"Hidden errors of each object of a frame. Left out: {_SEEDS}.")
    ] = None,
    scans: Annotated[
        int | None,
        typer.Option(min=1, max=1000, help=f"Scans of each view of a mesh. Left out: {_SCANS}, with --tolerance 10."),
    ] = None,
    proposer: Annotated[Proposer | None, typer.Option(help="Left out: the best one that is ready.")] = None,
    engine: Annotated[list[Engine] | None, typer.Option(help=f"{_ENGINE} Left out: posterior.")] = None,
    planner: Annotated[Planner, typer.Option(help="How the next region is chosen.")] = Planner.INFORMATION,
    camera: Annotated[
        list[CameraModel] | None, typer.Option(help="The simulated camera; repeatable. Left out: kinect.")
    ] = None,
    sensor: Annotated[
        list[FingerModel] | None, typer.Option(help="The simulated fingertip; repeatable. Left out: ideal.")
    ] = None,
    guarded: Annotated[bool, typer.Option("--guarded", help=_GUARDED)] = False,
    seed: Annotated[
        int,
        typer.Option(help="Fixes views, offsets, noise and proposals: two runs agree to the bit, for any --workers."),
    ] = 0,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; left out: one for each core.")] = None,
    only: Annotated[
        list[str] | None, typer.Option(help="Only this mesh or frame (file name without suffix); repeatable.")
    ] = None,
    split: Annotated[
        Split | None, typer.Option(help="Only this side of the meshes: choose on train, report on validation.")
    ] = None,
    limit: Annotated[
        int | None, typer.Option(min=1, help="Only the first so many meshes; with --split of mixed sources.")
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(min=0.0, help=_TOLERANCE),
    ] = None,
    stop: Annotated[bool | None, typer.Option("--stop/--no-stop", help=_STOP)] = None,
    clutter: Annotated[bool, typer.Option("--clutter", help=_CLUTTER)] = False,
    paper_setting: Annotated[
        bool, typer.Option("--paper-setting", help="As the paper tested: scans cut from the camera's own cloud.")
    ] = False,
    shared_scans: Annotated[
        bool, typer.Option("--shared-scans", help="All engines match the scans that the first one plans.")
    ] = False,
    details: Annotated[
        Path | None, typer.Option(help="Where each row's pose error goes, as JSON lines; with the stated covariance.")
    ] = None,
    report: Annotated[Path | None, typer.Option(help=_REPORT)] = None,
    campaign: Annotated[int | None, typer.Option(min=1, max=1000, help=_CAMPAIGN, rich_help_panel=_CAMPAIGNS)] = None,
    moving_camera: Annotated[bool, typer.Option("--moving-camera", help=_MOVING, rich_help_panel=_CAMPAIGNS)] = False,
    residual: Annotated[
        tuple[float, float] | None, typer.Option(metavar="M DEG", help=_RESIDUAL, rich_help_panel=_CAMPAIGNS)
    ] = None,
    knock: Annotated[
        tuple[int, float, float] | None,
        typer.Option(metavar="POSITION M DEG", help=_KNOCK, rich_help_panel=_CAMPAIGNS),
    ] = None,
    drift: Annotated[
        tuple[float, float] | None, typer.Option(metavar="M DEG", help=_DRIFT, rich_help_panel=_CAMPAIGNS)
    ] = None,
) -> None:
    """Score the whole loop on simulated views of a folder of meshes, or on real frames with default budgets.

    Each engine drives its own sessions unless --shared-scans is given.
    """
    console = Console(stderr=True)
    settings = read_campaign_options(campaign, moving_camera, residual, knock, drift)
    if settings is not None:
        wrong = {
            **{"--frames": frames, "--details": details, "--report": report, "--clutter": clutter},
            **{"--paper-setting": paper_setting, "--shared-scans": shared_scans},
        }
        refuse_beside_campaign([name for name, value in wrong.items() if value])
    _refuse_mixture(
        meshes is not None,
        frames is not None,
        for_meshes={
            **{"--views": views, "--scans": scans, "--camera": camera, "--split": split, "--limit": limit},
            **{"--paper-setting": paper_setting or None, "--clutter": clutter or None},
        },
        for_frames={"--seeds": seeds},
    )
    if report is not None and paper_setting:
        raise InvalidInput("--report cannot go with --paper-setting.", "Its scans are no sessions: leave one out.")
    tasks: list[Task]
    if frames is not None:
        tasks = [*frame_tasks(frames_in(frames, only or ()), range(seed, seed + (seeds or _SEEDS)))]
    else:
        folder = meshes or Path()
        paths = meshes_in(folder, only or (), limit, split)
        tasks = (
            []
            if settings
            else [*mesh_tasks(paths, range(views or _VIEWS), meshes_in(folder, split=split) if clutter else ())]
        )
    engines = [Engine.PAPER] if paper_setting else list(dict.fromkeys(engine or [Engine.POSTERIOR]))
    sensors = [FingerModel.IDEAL] if paper_setting else list(dict.fromkeys(sensor or [FingerModel.IDEAL]))
    cameras = list(dict.fromkeys(camera or [CameraModel.KINECT]))
    first = Protocol(
        scans=scans or _SCANS,
        proposer=proposer,
        engine=engines[0],
        planner=Planner.CONFIDENCE if paper_setting else planner,
        sensor=sensors[0],
        seed=seed,
        tolerance=tolerance or NEVER_CONVERGED,
        paper_setting=paper_setting,
        leader=engines[0] if shared_scans and len(engines) > 1 else None,
        camera=cameras[0],
        guarded=guarded,
    )
    if settings is not None and tolerance is None:
        first = replace(first, tolerance=Tolerance().error)
    if frames is not None:
        first = adapt_to_frames(first, tolerance)
    elif tolerance is not None or settings is not None:
        budgeted = adopt_default_budget(first)
        first = replace(budgeted, scans=scans or budgeted.scans)
    first = replace(first, stop=can_stop_in_time(first) if stop is None else stop)
    protocols = [
        replace(first, engine=one, sensor=finger, camera=seen)
        for seen in cameras
        for finger in sensors
        for one in engines
    ]
    check_file(out)
    for written in (details, report):
        if written is not None:
            check_file(written)
    if settings is not None:
        wanted = campaigns(settings, paths, views or _VIEWS, seed)
        evaluate_campaigns(out, wanted, protocols, workers or os.cpu_count() or 1, console)
        return
    kept = PartialResults(out, first)
    try:
        runs = run_with_progress(tasks, protocols, workers, kept, console)
    except KeyboardInterrupt:
        total = len(tasks) * len(protocols)
        said = f"are kept in {kept.path}; the same command goes on" if kept.path else "were made; none is kept"
        console.print(f"Interrupted. {len(kept.runs)} of {total} runs {said}.", markup=False, soft_wrap=True)
        raise typer.Exit(INTERRUPTED) from None
    rows = [row.as_dict() for run in runs for row in run.rows]
    write_json(out, {"command": shlex.join(["pretouch", *sys.argv[1:]]), "seed": seed, "rows": rows})
    if details is not None:
        write_details(details, runs)
    kept.remove()
    if report is not None:
        with console.status("Repeating the worst runs for their report ..."):
            save_worst_runs(runs, tasks, protocols, f"{shlex.join(['pretouch', *sys.argv[1:]])}. Seed {seed}.", report)
    _report(runs, first, out)
    if any(run.problem for run in runs):
        raise typer.Exit(1)


def _refuse_mixture(meshes: bool, frames: bool, *, for_meshes: dict[str, Any], for_frames: dict[str, Any]) -> None:
    """Raises InvalidInput unless one of the folders is given, and no option that goes with the other one."""
    if meshes == frames:
        said = "Both --meshes and --frames are given." if meshes else "Neither --meshes nor --frames is given."
        raise InvalidInput(said, "Give one of them.")
    wrong = [name for name, value in (for_frames if meshes else for_meshes).items() if value is not None]
    if wrong:
        here, there = ("--meshes", "--frames") if meshes else ("--frames", "--meshes")
        raise InvalidInput(f"{', '.join(wrong)} cannot go with {here}.", f"Leave it out, or give {there} instead.")


def _report(runs: Sequence[Run], protocol: Protocol, out: Path) -> None:
    console = open_console(out)
    setups = group_by_setup(runs)
    single = len(setups) == 1
    if setups:
        scans = range(protocol.scans + 1)
        tables = [tabulate_by_object(runs, protocol.scans)] if single else []
        tables += [tabulate_by_scan(runs, scans), honesty_table(runs, scans)]
        if protocol.tolerance != NEVER_CONVERGED:
            tables.append(convergence_table(runs, protocol.tolerance))
            tables.append(convergence_by_scan_table(runs, protocol.tolerance))
        for part in (part for table in tables for part in table.rich(console.width)):
            console.print(part)
    for run in runs:
        name = f"{run.mesh}, view {run.view}" + (f", frame {run.frame}" if run.frame else "")
        name += "" if single else f", {run.engine}, {run.camera}, {run.sensor}"
        if run.problem:
            console.print(f"{name} failed: {run.problem}", style="red", markup=False, soft_wrap=True)
        elif not run.rows:
            console.print(f"{name}: no scan could be planned; it has no row.", style="yellow")
    if out != STANDARD_OUTPUT:
        console.print(f"The rows are in {out}.", markup=False, soft_wrap=True)
