"""`pretouch evaluate --campaign`: objects in turn, seen by one camera that learns its calibration from each."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from pretouch.errors import InvalidInput
from pretouch.interrupts import INTERRUPTED
from pretouch.results import STANDARD_OUTPUT, write_json
from pretouch_simulation.campaign_sessions import CampaignRun, key_of, run_campaign, settings_of
from pretouch_simulation.campaign_table import campaign_table
from pretouch_simulation.campaign_world import Campaign, CampaignSettings, Change
from pretouch_simulation.evaluation import warm_up
from pretouch_simulation.evaluation_console import open_console
from pretouch_simulation.evaluation_protocol import Protocol
from pretouch_simulation.partial_rows import PartialRows
from pretouch_simulation.workers import run_in_workers


def read_campaign_options(
    objects: int | None,
    moving: bool,
    residual: tuple[float, float] | None,
    knock: tuple[int, float, float] | None,
    drift: tuple[float, float] | None,
) -> CampaignSettings | None:
    """The settings that the options ask for, m and deg; None without `--campaign`.

    Raises:
        InvalidInput: an option that needs `--campaign`, or a value out of its limits.
    """
    if objects is None:
        given = {"--moving-camera": moving, "--residual": residual, "--knock": knock, "--drift": drift}
        if wrong := [name for name, value in given.items() if value]:
            raise InvalidInput(f"{', '.join(wrong)} cannot go without --campaign.", "Give --campaign too.")
        return None
    if knock is not None and not 2 <= knock[0] <= objects:
        raise InvalidInput(f"--knock is at position {knock[0]}.", f"Give a position of 2 to {objects}.")
    return CampaignSettings(
        objects,
        moving,
        CampaignSettings.residual if residual is None else _change(*residual),
        None if knock is None else knock[0],
        Change() if knock is None else _change(*knock[1:]),
        Change() if drift is None else _change(*drift),
    )


def refuse_beside_campaign(options: Sequence[str]) -> None:
    """Raises InvalidInput if any of these options was given."""
    if options:
        raise InvalidInput(f"{', '.join(options)} cannot go with --campaign.", "Leave it out.")


def evaluate_campaigns(
    out: Path, wanted: Sequence[Campaign], protocols: Sequence[Protocol], workers: int, console: Console
) -> None:
    """Runs each campaign by each protocol with and without `camera.id`, writes the rows and shows the table.

    Raises:
        Conflict: OUT.partial was left by an evaluation with other settings.
        typer.Exit: it was interrupted, or a session could not be made.
    """
    path = (
        out.with_name(out.name + ".partial") if out != STANDARD_OUTPUT and (out.is_file() or not out.exists()) else None
    )
    kept = PartialRows(path, settings_of(wanted[0], protocols[0]), "--json")
    runs = {run.key: run for run in map(CampaignRun.from_dict, kept.rows)}
    calls = [(one, protocol, learns) for protocol in protocols for one in wanted for learns in (True, False)]
    missing = [call for call in calls if key_of(*call) not in runs]
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    try:
        with Progress(*columns, console=console) as progress:
            bar = progress.add_task("campaigns", total=len(calls), completed=len(calls) - len(missing))
            for run in run_in_workers(run_campaign, missing, workers, warm_up, (protocols,)):
                kept.add(run.as_dict())
                runs[run.key] = run
                progress.advance(bar)
    except KeyboardInterrupt:
        said = f"are kept in {path}; the same command goes on" if path else "were made; none is kept"
        console.print(f"Interrupted. {len(runs)} of {len(calls)} campaigns {said}.", markup=False, soft_wrap=True)
        raise typer.Exit(INTERRUPTED) from None
    made = [runs[key_of(*call)] for call in calls]
    rows, others = (
        [row.as_dict() for run in made if run.key.learns is learns for row in run.rows] for learns in (True, False)
    )
    command, seed = shlex.join(["pretouch", *sys.argv[1:]]), wanted[0].seed
    write_json(out, {"command": command, "seed": seed, "rows": rows, "rows_without_camera_id": others})
    kept.remove()
    _report(made, protocols[0].tolerance, out)
    if any(run.problems for run in made):
        raise typer.Exit(1)


def _report(runs: Sequence[CampaignRun], tolerance: float, out: Path) -> None:
    console = open_console(out)
    if any(run.rows for run in runs):
        for part in campaign_table(runs, tolerance).rich(console.width):
            console.print(part)
    for run in runs:
        for position, said in run.problems.items():
            where = f"Campaign {run.key.campaign}, object {position}" + (
                "" if run.key.learns else ", without camera.id"
            )
            console.print(f"{where} failed: {said}", style="red", markup=False, soft_wrap=True)
    if out != STANDARD_OUTPUT:
        console.print(f"The rows are in {out}.", markup=False, soft_wrap=True)


def _change(metres: float, degrees: float) -> Change:
    return Change(metres, float(np.radians(degrees)))
