"""How often a broken fingertip is detected within its first scans, and how often a sound one raises a false alarm.

    python -m experiments.sensor_faults [--meshes DIR] [--limit 20] [--seed 0] [--out docs/results]

Writes sensor-faults.md. DIR is data/meshes/train of PRETOUCH_SHARED unless given; its side for choosing parameters.
"""

from __future__ import annotations

import argparse
import asyncio
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from pretouch_orchestrator.perception.sensor_check import diagnose
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar
from pretouch_simulation.evaluation_protocol import Protocol, finger_of, loop_of, request_of
from pretouch_simulation.finger import Finger, FingerModel
from pretouch_simulation.fingers.faults import (
    make_dead_finger,
    make_millimetre_finger,
    make_noise_finger,
    make_stuck_finger,
)
from pretouch_simulation.markdown import markdown_table
from pretouch_simulation.mesh import load_mesh
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.protocol import Case, generator, make_case
from pretouch_simulation.scanning import scan_along
from pretouch_simulation.split import Split
from rich.progress import track

from experiments.command_line import command_of
from experiments.folders import RESULTS, SHARED
from pretouch.errors import InvalidInput
from pretouch.geometry import Pose
from pretouch.session import Planner, Proposer, State

SCANS = 2
FAULTS: dict[str, Callable[[Finger], Finger]] = {
    "always 30 mm": make_stuck_finger,
    "always 60 mm": lambda finger: make_stuck_finger(finger, at=0.06),
    "noise": make_noise_finger,
    "millimetres": make_millimetre_finger,
    "dead": make_dead_finger,
}


class Outcome(NamedTuple):
    """A session's first scans: how many had a diagnosis or no return, the error before and after, m, and the end."""

    diagnoses: int
    empty: int
    initial: float
    error: float
    state: State


async def run_session(
    case: Case, protocol: Protocol, registrar: Registrar, fault: Callable[[Finger], Finger]
) -> Outcome:
    """The first scans of `case` by the protocol's finger as the fault leaves it."""
    loop, finger = loop_of(protocol, registrar), fault(finger_of(case, protocol))
    request = replace(request_of(case, protocol), sensor=finger.sensor)
    record = await loop.open(case.name, 0.0, request, case.depth, case.mask)
    diagnoses = empty = 0
    while record.next_scan is not None and len(record.scans) < SCANS:
        rng = generator("finger", protocol.seed, case.name, case.view, len(record.scans))
        samples = scan_along(case.world, record.next_scan.path, finger.sensor, finger, rng)
        diagnoses += bool(diagnose(samples, finger.sensor, record.scene, record.estimate, record.measured))
        empty += not samples.beams(finger.sensor).returned.any()
        try:
            record = await loop.advance(record, record.next_scan.scan_id, samples)
        except InvalidInput:  # ranges in millimetres are refused
            break
    error = case.error(record.estimate.base_T_correction)
    return Outcome(diagnoses, empty, case.error(Pose.identity()), error, record.state)


def text(command: str, meshes: int, rows: dict[str, list[Outcome]]) -> str:
    """The page."""
    lines = [
        "# Broken fingertips noticed, sound ones doubted\n",
        f"Made by `{command}`: {meshes} meshes of the training side, one view each, the first {SCANS} scans of a "
        "session (proposer random, default budget and tolerance). A scan with a diagnosis is one that was left out; an "
        "empty one is one without any return. The broken fingertips are `ideal` ones but for their fault.\n",
    ]
    headings = (
        *("fingertip", "sessions", "with a diagnosis", "scans with a diagnosis", "empty scans", "over 1 mm worse"),
        "converged",
    )
    cells = []
    for name, outcomes in rows.items():
        counts = [
            len(outcomes),
            sum(outcome.diagnoses > 0 for outcome in outcomes),
            sum(outcome.diagnoses for outcome in outcomes),
            sum(outcome.empty for outcome in outcomes),
            sum(outcome.error > outcome.initial + 0.001 for outcome in outcomes),
            sum(outcome.state is State.CONVERGED for outcome in outcomes),
        ]
        cells.append([name, *map(str, counts)])
    return "\n".join([*lines, markdown_table(headings, cells)])


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--meshes", type=Path, default=SHARED / "data" / "meshes" / "train")
    parser.add_argument("--limit", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=RESULTS)
    given = parser.parse_args(arguments)
    paths = meshes_in(given.meshes, limit=given.limit, split=Split.TRAIN)
    registrar, rows = Registrar(), defaultdict[str, list[Outcome]](list)
    kinds = [(f"`{model}`", model, lambda finger: finger) for model in FingerModel]
    kinds += [(name, FingerModel.IDEAL, fault) for name, fault in FAULTS.items()]
    for path in track(paths, "Sessions"):
        case = make_case(path.stem, load_mesh(path), 0, given.seed)
        for name, model, fault in kinds:
            protocol = Protocol(
                10, Proposer.RANDOM, Engine.POSTERIOR, Planner.INFORMATION, model, given.seed, tolerance=0.003
            )
            rows[name].append(asyncio.run(run_session(case, protocol, registrar, fault)))
    command = command_of("sensor_faults", arguments)
    (given.out / "sensor-faults.md").write_text(text(command, len(paths), rows))


if __name__ == "__main__":
    main()
