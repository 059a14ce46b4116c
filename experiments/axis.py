"""Cups, bowls and other round things: the error tolerated on their axis alone, against that of the whole object.

    python -m experiments.axis [--limit 8] [--views 1] [--seed 0] [--out docs/results]

Writes axis.json and axis.md. Both sessions of a view have the same image, hidden calibration error and finger, and the
default tolerance and budget; their robot finishes its scans. The points are those of the object's vertical axis at half
its height and at its top, as the camera puts them. Sessions are kept in axis.partial.jsonl of the folder `--out`, so
that the same command goes on after an interruption.
"""

from __future__ import annotations

import argparse
import asyncio
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pretouch_orchestrator.sessions.record import Record
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.evaluation import warm_up
from pretouch_simulation.evaluation_protocol import (
    Protocol,
    adopt_default_budget,
    finger_of,
    loop_of,
    request_of,
)
from pretouch_simulation.evaluation_tasks import MeshTask
from pretouch_simulation.finger import FingerModel
from pretouch_simulation.markdown import markdown_table
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.partial_rows import PartialRows
from pretouch_simulation.protocol import PLACE, Case, generator
from pretouch_simulation.scanning import scan_along
from pretouch_simulation.workers import run_in_workers
from rich.console import Console

from experiments.command_line import command_of, run_resumable
from experiments.folders import SHARED
from pretouch.errors import PretouchError
from pretouch.geometry import Array
from pretouch.session import Planner, SessionRequest, State, Tolerance

MESHES = (
    *("cram__bowl", "cram__bowl_b", "cram__cup", "gso__porcelain_cup", "gso__red_cup", "libero__red_bowl"),
    *("libero__glazed_rim_porcelain_ramekin", "objsim__bowl", "objsim__cup", "objsim__cylinderlarge"),
    *("urdfmodels__blue_cup", "urdfmodels__doraemon_bowl", "urdfmodels__green_bowl", "urdfmodels__pen_container_1"),
)
"""Of the training meshes: cups, bowls and cans without a handle, standing."""
WORLDS = {
    "kinect ideal": (CameraModel.KINECT, FingerModel.IDEAL),
    "random random": (CameraModel.RANDOM, FingerModel.RANDOM),
}


@dataclass(frozen=True)
class Row:
    """A session.

    Attributes:
        on_axis: whether the error counts on the axis alone.
        round: whether the session warned that the object looks round.
        scans, seconds, state: what it took, and how it ended.
        error, axis_error: m, the true errors at the end of the object's visible points, and of those on the axis.
        expected, quantile: m, as stated, at the points where the error counts.
    """

    mesh: str
    view: int
    world: str
    on_axis: bool
    round: bool
    scans: int
    seconds: float
    state: str
    error: float
    axis_error: float
    expected: float
    quantile: float

    @property
    def converged(self) -> bool:
        return self.state == State.CONVERGED.value

    @property
    def counted_error(self) -> float:
        """m: the true error where it counts."""
        return self.axis_error if self.on_axis else self.error


def protocol_of(world: str, seed: int) -> Protocol:
    camera, finger = WORLDS[world]
    protocol = Protocol(10, None, Engine.POSTERIOR, Planner.INFORMATION, finger, seed, camera=camera)
    return replace(adopt_default_budget(protocol), tolerance=Tolerance().error)


def points_on_axis(case: Case) -> Array:
    """(2, 3), m: points of the object's vertical axis at half its height and at its top, as the camera puts them."""
    body = case.world.bodies[0]
    heights = np.array([0.5, 1.0]) * body.mesh.extents[2]
    true = PLACE + np.column_stack([np.zeros(2), np.zeros(2), heights])
    return np.asarray(case.truth.inverse().apply(true), dtype=np.float64)


async def run_session(case: Case, request: SessionRequest, protocol: Protocol, registrar: Registrar) -> Record:
    """The session at its end."""
    loop, finger = loop_of(protocol, registrar), finger_of(case, protocol)
    record = await loop.open(f"{case.name}-{case.view}", 0.0, request, case.depth, case.mask)
    while record.next_scan is not None:
        plan = record.next_scan
        rng = generator("finger", protocol.seed, case.name, case.view, len(record.scans))
        samples = scan_along(case.world, plan.path, request.sensor, finger, rng, None)
        record = await loop.advance(record, plan.scan_id, samples)
    return record


def run_view(path: Path, view: int, world: str, seed: int) -> list[dict[str, Any]]:
    """Both sessions of a view; none where the services refuse it."""
    protocol = protocol_of(world, seed)
    try:
        case = MeshTask(path, view).case(seed, protocol.camera)
        at = points_on_axis(case)
        request, registrar = request_of(case, protocol), Registrar()
        tolerances = (request.tolerance, replace(request.tolerance, at=at))
        ends = [
            asyncio.run(run_session(case, replace(request, tolerance=each), protocol, registrar)) for each in tolerances
        ]
    except PretouchError:
        return []
    warned = any(warning.code == "object-round" for warning in ends[0].warnings)
    return [asdict(_describe(case, end, at, warned, world)) for end in ends]


def _describe(case: Case, record: Record, at: Array, warned: bool, world: str) -> Row:
    correction = record.estimate.base_T_correction
    return Row(
        mesh=case.name,
        view=case.view,
        world=world,
        on_axis=record.request.tolerance.at is not None,
        round=warned,
        scans=record.budget_used.scans,
        seconds=record.budget_used.seconds,
        state=record.state.value,
        error=case.error(correction),
        axis_error=float(np.linalg.norm(case.truth.apply(at) - correction.apply(at), axis=1).mean()),
        expected=record.estimate.expected_error,
        quantile=record.estimate.error_quantile,
    )


def prepare() -> None:
    warm_up([protocol_of(world, 0) for world in WORLDS])


def run(arguments: argparse.Namespace) -> None:
    kept = PartialRows(arguments.out / "axis.partial.jsonl", {"seed": arguments.seed})
    known = {(row["mesh"], row["view"], row["world"]) for row in kept.rows}
    paths = meshes_in(arguments.meshes, only=MESHES, limit=arguments.limit)
    calls = [
        (path, view, world, arguments.seed)
        for view in range(arguments.views)
        for path in paths
        for world in WORLDS
        if (path.stem, view, world) not in known
    ]
    console = Console(stderr=True)
    for made in run_in_workers(run_view, calls, arguments.workers or 1, prepare):
        for row in made:
            kept.add(row)
        console.print(f"{len(kept.rows)} sessions")
    rows = [Row(**row) for row in kept.rows]
    command = command_of("axis")
    content = {"command": command, "seed": arguments.seed, "rows": [asdict(row) for row in rows]}
    (arguments.out / "axis.json").write_text(json.dumps(content) + "\n")
    (arguments.out / "axis.md").write_text(write_page(rows, command, arguments.seed))


def write_page(rows: Sequence[Row], command: str, seed: int) -> str:
    """The page."""
    names = sorted({row.mesh for row in rows})
    headings = (
        *("world", "the error counts", "n", "warned: round", "converged", "of those truly within 3 mm"),
        *("robot s, median", "robot s, mean", "scans, mean", "true error there, median mm", "stated mean mm"),
    )
    lines = []
    for world in WORLDS:
        for on_axis in (False, True):
            chosen = [row for row in rows if row.world == world and row.on_axis is on_axis]
            if chosen:
                lines.append((world, "on the axis" if on_axis else "on the whole object", *_summarize(chosen)))
    return (
        "# Where the error counts: the axis of round things\n\n"
        f"Made by `{command}`, seed {seed}: {len(names)} cups, bowls and cans of the training meshes "
        f"({', '.join(names)}), each view once with the default tolerance and once with `tolerance.at` on its "
        "axis; the same images, calibration errors and fingers, default budgets; robots that finish their scans. "
        "The worlds are simulated.\n\n" + markdown_table(headings, lines)
    )


def _summarize(rows: Sequence[Row]) -> tuple[str, ...]:
    done = [row for row in rows if row.converged]
    within = sum(row.counted_error <= Tolerance().error for row in done)
    seconds = np.array([row.seconds for row in rows])
    return (
        str(len(rows)),
        str(sum(row.round for row in rows)),
        f"{len(done)} ({len(done) / len(rows):.0%})",
        f"{within} of {len(done)}",
        f"{np.median(seconds):.1f}",
        f"{seconds.mean():.1f}",
        f"{np.mean([row.scans for row in rows]):.1f}",
        f"{1000 * np.median([row.counted_error for row in rows]):.1f}",
        f"{1000 * np.mean([row.expected for row in rows]):.1f}",
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", type=Path, default=SHARED / "data" / "meshes" / "train")
    parser.add_argument("--limit", type=int, help="how many of the meshes, the first ones by name")
    parser.add_argument("--views", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    run_resumable(parser, run)


if __name__ == "__main__":
    main()
