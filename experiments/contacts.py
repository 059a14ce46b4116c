"""How near the finger comes to things in simulated scans, guarded or not, and how often it touches one.

    python -m experiments.contacts [--meshes DIR] [--split train] [--frames DIR] [--scans 10000] [--camera kinect]
        [--seed 0] [--workers N] [--out docs/results]

A scene is an object of DIR among others of it, or an object of a real frame, under a hidden calibration error of the
protocol. In each the finger flies every path that the planner offers for the first scan, over the object and beside it,
and the scans of two sessions, one of them guarded; a path offered is flown by one of the finger models in turn. The
finger is a cylinder of 10 mm radius. Writes contacts.json and contacts.png. DIR is data/meshes/train of PRETOUCH_SHARED
unless given. A run that was stopped goes on when it is started again.
"""

from __future__ import annotations

import argparse
import asyncio
import os
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pretouch_orchestrator.sessions.transitions import plan_nearby, plan_over_object
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar
from pretouch_simulation.contact import measure_clearance
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.evaluation_protocol import Protocol, finger_of, loop_of, request_of
from pretouch_simulation.evaluation_tasks import Task, frame_tasks, mesh_tasks
from pretouch_simulation.finger import Finger, FingerModel
from pretouch_simulation.frame_folder import frames_in
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.partial_rows import PartialRows
from pretouch_simulation.protocol import Case, generator
from pretouch_simulation.scanning import fly_guarded, scan_along
from pretouch_simulation.split import Split
from pretouch_simulation.workers import run_in_workers
from rich.console import Console
from rich.progress import Progress

from experiments.command_line import command_of, run_resumable
from experiments.contacts_picture import save_histogram
from experiments.folders import SHARED
from pretouch.client import Reflex
from pretouch.errors import PretouchError
from pretouch.geometry import Array
from pretouch.results import write_json
from pretouch.session import Planner, Proposer
from pretouch.tof import RangeSamples
from pretouch.trajectory import Trajectory

SESSION_SCANS = 3
MODELS = tuple(FingerModel)


class Flight(NamedTuple):
    """A flown scan.

    Attributes:
        sensor: the finger model.
        scan: 0: a path that was offered for the first scan; else its number in the session.
        clearance: m, see `measure_clearance`.
    """

    guarded: bool
    sensor: str
    scan: int
    clearance: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", type=Path, default=SHARED / "data" / "meshes" / "train")
    parser.add_argument("--split", type=Split, choices=list(Split))
    parser.add_argument("--frames", type=Path, help="the objects of these real frames, first")
    parser.add_argument("--scans", type=int, default=10_000, help="how many at least, if there are so many")
    parser.add_argument("--camera", type=CameraModel, choices=list(CameraModel), default=CameraModel.KINECT)
    parser.add_argument("--seed", type=int, default=0)
    run_resumable(parser, run)


def run(given: argparse.Namespace) -> None:
    """The experiment."""
    settings = {name: str(getattr(given, name)) for name in ("meshes", "split", "frames", "camera", "seed")}
    kept = PartialRows(given.out / "contacts.partial.jsonl", settings)
    made = {row["scene"] for row in kept.rows}
    calls = [
        (number, task, given.camera, given.seed)
        for number, task in enumerate(list_scenes(given))
        if name_scene(task) not in made
    ]
    workers = given.workers or os.cpu_count() or 1
    with Progress(console=Console(stderr=True)) as progress:
        bar = progress.add_task("Scans", total=given.scans, completed=count_scans(kept.rows))
        with closing(run_in_workers(fly_scene, calls, workers, prepare)) as rows:
            while count_scans(kept.rows) < given.scans and (row := next(rows, None)) is not None:
                kept.add(row)
                progress.update(bar, completed=count_scans(kept.rows))
    write_results(kept.rows, given.out)
    kept.remove()


def list_scenes(given: argparse.Namespace) -> list[Task]:
    """The scenes, in an order that mixes objects and views."""
    paths = meshes_in(given.meshes, split=given.split)
    frames = frame_tasks(frames_in(given.frames), range(given.seed, given.seed + 3)) if given.frames else []
    order = generator("contacts", given.seed).permutation(len(paths))
    return [*frames, *(task for view in range(3) for task in mesh_tasks([paths[k] for k in order], [view], paths))]


def name_scene(task: Task) -> str:
    """Its name in the rows."""
    return f"{task.frame or 'clutter'} {task.mesh} {task.view}"


def count_scans(rows: Sequence[dict[str, Any]]) -> int:
    """How many were flown in the scenes of the rows."""
    return sum(len(row["flights"]) for row in rows)


def prepare() -> None:
    """Nothing is compiled in advance."""


def fly_scene(number: int, task: Task, camera: CameraModel, seed: int) -> dict[str, Any]:
    """The row of a scene: all its flights, and why there are none.

    Args:
        number: says which of MODELS the sessions' finger is.
    """
    flights: list[Flight] = []
    problem = ""
    try:
        case = task.case(seed, camera)
        for guarded in (False, True):
            model = MODELS[number % len(MODELS)]
            protocol = Protocol(
                *(SESSION_SCANS, Proposer.RANDOM, Engine.POSTERIOR, Planner.INFORMATION, model, seed), guarded=guarded
            )
            flights += asyncio.run(_fly_session(case, protocol))
    except PretouchError as error:
        problem = f"{error.detail} {error.remedy}"
    return {"scene": name_scene(task), "flights": [flight._asdict() for flight in flights], "problem": problem}


async def _fly_session(case: Case, protocol: Protocol) -> list[Flight]:
    loop = loop_of(protocol, Registrar())
    record = await loop.open(case.name, 0.0, request_of(case, protocol), case.depth, case.mask)
    flights = []
    for k, candidate in enumerate([*plan_over_object(record), *plan_nearby(record)]):
        model = MODELS[(MODELS.index(protocol.sensor) + k) % len(MODELS)]
        finger = finger_of(case, replace(protocol, sensor=model))
        rng = generator("contacts", protocol.seed, case.name, case.view, k)
        _, clearance = fly(case, candidate.path, finger, rng, protocol.guarded)
        flights.append(Flight(protocol.guarded, model.value, 0, clearance))
    finger = finger_of(case, protocol)
    while record.next_scan is not None:
        rng = generator("finger", protocol.seed, case.name, case.view, len(record.scans))
        samples, clearance = fly(case, record.next_scan.path, finger, rng, protocol.guarded)
        flights.append(Flight(protocol.guarded, protocol.sensor.value, len(record.scans) + 1, clearance))
        record = await loop.advance(record, record.next_scan.scan_id, samples)
    return flights


def fly(
    case: Case, path: Trajectory, finger: Finger, rng: np.random.Generator, guarded: bool
) -> tuple[RangeSamples, float]:
    """Flies a path; its samples, and the least clearance of the finger in m."""
    if not guarded:
        return scan_along(case.world, path, finger.sensor, finger, rng), measure_clearance(case.world, path.base_T_tip)
    descent, samples = fly_guarded(case.world, path, finger.sensor, finger, rng, Reflex())
    return samples, measure_clearance(case.world, np.concatenate([descent, samples.base_T_tip]))


def write_results(rows: Sequence[dict[str, Any]], out: Path) -> None:
    """Writes contacts.json and contacts.png."""
    flights = [Flight(**flight) for row in rows for flight in row["flights"]]
    groups: dict[str, list[Flight]] = {}
    for flight in flights:
        groups.setdefault("guarded" if flight.guarded else "not guarded", []).append(flight)
    document = {
        "command": command_of("contacts"),
        "scenes": len(rows),
        "problems": [f"{row['scene']}: {row['problem']}" for row in rows if row["problem"]],
        "contacts": [
            {"scene": row["scene"], **flight} for row in rows for flight in row["flights"] if flight["clearance"] <= 0
        ],
        "clearance_mm": {name: _summarise(group) for name, group in groups.items()},
    }
    write_json(out / "contacts.json", document)
    clearances = {name: np.array([flight.clearance for flight in group]) for name, group in groups.items()}
    save_histogram(clearances, f"the finger's nearest approach in {len(rows)} scenes", out / "contacts.png")


def _summarise(flights: Sequence[Flight]) -> dict[str, Any]:
    """Numbers of scans and contacts, and the least clearances in mm, by finger model and for first and later scans."""
    kinds = {
        "all": flights,
        **{model.value: [flight for flight in flights if flight.sensor == model.value] for model in MODELS},
        "later scans": [flight for flight in flights if flight.scan > 1],
    }
    return {name: _count(np.array([flight.clearance for flight in kind])) for name, kind in kinds.items() if kind}


def _count(clearances: Array) -> dict[str, float]:
    least, percentile, median = 1000 * np.quantile(clearances, (0.0, 0.01, 0.5))
    return {
        "scans": len(clearances),
        "contacts": int((clearances <= 0).sum()),
        "least": round(float(least), 1),
        "1st percentile": round(float(percentile), 1),
        "median": round(float(median), 1),
    }


if __name__ == "__main__":
    main()
