"""Forecasts of sessions against what became of them; fits the forecast's coefficients.

    python -m experiments.forecast --split train --sessions 40 --fit [--world NAME]
    python -m experiments.forecast --split validation --sessions 40 --seed 1 [--world NAME] [--out docs/results]

Each session is of another view of the split's meshes, in the world `random random` unless another is named, with
tolerance, budget and points drawn for it (`draw_request`); its robot finishes its scans. With `--fit` all have the
strictest tolerance and the largest budget, and are cut to the others (`experiments.forecast_fit`). Sessions are kept in
forecast-SPLIT-WORLD.jsonl of the folder `--out`, so that the same command goes on after an interruption. `--fit` prints
coefficients for pretouch_orchestrator.sessions.forecast from the sessions of all worlds there; without it forecast.md
and forecast.png are written of them.
"""

from __future__ import annotations

import argparse
import asyncio
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from pretouch_orchestrator.sessions import forecast
from pretouch_orchestrator.sessions.endings import error_quantile, is_explained
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_orchestrator.sessions.record import Record
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar
from pretouch_simulation.evaluation import warm_up
from pretouch_simulation.evaluation_protocol import Protocol, finger_of, loop_of, request_of
from pretouch_simulation.evaluation_tasks import MeshTask
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.partial_rows import PartialRows
from pretouch_simulation.protocol import Case, generator
from pretouch_simulation.scanning import scan_along
from pretouch_simulation.split import Split
from pretouch_simulation.workers import run_in_workers
from rich.console import Console

from experiments.axis import WORLDS
from experiments.command_line import command_of, run_resumable
from experiments.folders import SHARED
from experiments.forecast_course import Course
from experiments.forecast_fit import SCANS, SECONDS, TOLERANCES, fit_coefficients
from experiments.forecast_report import write_report
from pretouch.errors import PretouchError
from pretouch.session import Budget, Planner, SessionRequest, Tolerance


def protocol_of(world: str, seed: int) -> Protocol:
    camera, finger = WORLDS[world]
    return Protocol(
        10,
        None,
        Engine.POSTERIOR,
        Planner.INFORMATION,
        finger,
        seed,
        camera=camera,
        tolerance=Tolerance().error,
    )


def draw_request(case: Case, protocol: Protocol, drawn: bool) -> SessionRequest:
    """What the client of this case asks for: in a quarter of the cases it needs one visible point of the object.

    Args:
        drawn: whether tolerance and budget are drawn; if not, they are the strictest and the largest.
    """
    rng = generator("forecast", protocol.seed, case.name, case.view)
    at = case.cloud[rng.integers(len(case.cloud))][None] if rng.random() < 0.25 else None
    return replace(
        request_of(case, protocol),
        tolerance=Tolerance(error=float(rng.choice(TOLERANCES)) if drawn else min(TOLERANCES), at=at),
        budget=Budget(
            scans=int(rng.choice(SCANS)) if drawn else max(SCANS),
            seconds=float(rng.choice(SECONDS)) if drawn else max(SECONDS),
        ),
    )


async def run_session(case: Case, request: SessionRequest, protocol: Protocol, registrar: Registrar) -> list[Record]:
    """The session's record at its creation and after each scan.

    Raises:
        PretouchError: the services refuse it.
    """
    loop: Loop = loop_of(protocol, registrar)
    finger = finger_of(case, protocol)
    record = await loop.open(f"{case.name}-{case.view}", 0.0, request, case.depth, case.mask)
    records = [record]
    while record.next_scan is not None:
        plan = record.next_scan
        rng = generator("finger", protocol.seed, case.name, case.view, len(records))
        samples = scan_along(case.world, plan.path, request.sensor, finger, rng, None)
        record = await loop.advance(record, plan.scan_id, samples)
        records.append(record)
    return records


def run_view(path: Path, view: int, world: str, seed: int, drawn: bool) -> dict[str, Any] | None:
    """A session as a row; None where the object cannot be seen or the services refuse it."""
    protocol = protocol_of(world, seed)
    try:
        case = MeshTask(path, view).case(seed, protocol.camera)
        records = asyncio.run(run_session(case, draw_request(case, protocol, drawn), protocol, Registrar()))
    except PretouchError:
        return None
    last, open_ = records[-1], [record for record in records if record.forecast is not None]
    at = last.request.tolerance.at
    points = case.cloud if at is None else at
    moved = last.estimate.base_T_correction.apply(points)
    row = Course(
        world=world,
        mesh=path.stem,
        view=view,
        tolerance=last.request.tolerance.error,
        features=[list(forecast.describe(record)) for record in open_],
        rest=[forecast.measure_rest(record) for record in open_],
        spent=[record.budget_used.seconds for record in open_],
        durations=[record.next_scan.path.duration for record in open_ if record.next_scan is not None],
        quantiles=[error_quantile(record) for record in records],
        explained=[is_explained(record.estimate) for record in records],
        seconds=last.budget_used.seconds,
        state=last.state.value,
        reason=str((last.reason or {}).get("type", "")).rpartition("/")[2],
        error=float(np.linalg.norm(case.truth.apply(points) - moved, axis=1).mean()),
    )
    return asdict(row)


def prepare() -> None:
    warm_up([protocol_of(world, 0) for world in WORLDS])


def run(arguments: argparse.Namespace) -> None:
    kept = rows_of(arguments, arguments.world)
    paths = meshes_in(arguments.meshes, split=arguments.split)
    known = {(row["mesh"], row["view"]) for row in kept.rows}
    tasks = [(paths[k % len(paths)], k) for k in range(arguments.sessions)]
    calls = [
        (*task, arguments.world, arguments.seed, not arguments.fit)
        for task in tasks
        if (task[0].stem, task[1]) not in known
    ]
    console = Console(stderr=True)
    for row in run_in_workers(run_view, calls, arguments.workers or 1, prepare):
        if row is not None:
            kept.add(row)
            console.print(f"{len(kept.rows)}: {row['mesh']} {row['state']} {row['reason']}")
    rows = [Course(**row) for world in WORLDS for row in rows_of(arguments, world).rows]
    if arguments.fit:
        print(fit_coefficients(rows))
    else:
        by_world = {world: [row for row in rows if row.world == world] for world in reversed(WORLDS)}
        write_report(by_world, command_of("forecast"), arguments.out)


def rows_of(arguments: argparse.Namespace, world: str) -> PartialRows:
    """The sessions in that world so far."""
    settings = {"split": arguments.split.value, "seed": arguments.seed, "fit": arguments.fit, "world": world}
    return PartialRows(arguments.out / f"forecast-{arguments.split}-{world.replace(' ', '-')}.jsonl", settings)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", type=Path, default=SHARED / "data" / "meshes" / "train")
    parser.add_argument("--split", type=Split, choices=list(Split), default=Split.VALIDATION)
    parser.add_argument("--world", choices=list(WORLDS), default="random random")
    parser.add_argument("--sessions", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--fit", action="store_true", help="fit coefficients instead of reporting")
    run_resumable(parser, run)


if __name__ == "__main__":
    main()
