"""The registrar's engines compared: their errors, whether their uncertainty is honest, and where they fail.

    python -m experiments.registration [--meshes DIR] [--split validation] [--limit 40] [--analogues DIR] [--views 4]
        [--scans 5] [--engines paper ...] [--sensors ideal vl6180x] [--shared-scans] [--out docs/results]

The protocol of `pretouch evaluate`, proposer `random`, on two folders: the validation side of the training meshes and
the analogues of the paper's Table 1. Parameters are chosen on the other side, `train`. Writes registration.md,
registration.json and pictures. A run that was stopped goes on when it is started again; finished runs lie beside
the results. DIRs are data/meshes/train and data/meshes/table1 of PRETOUCH_SHARED unless given.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from pretouch_registrar.engines import Engine
from pretouch_simulation.evaluation import run_steps
from pretouch_simulation.evaluation_comparison import compare_engines, comparison_table
from pretouch_simulation.evaluation_honesty import honesty
from pretouch_simulation.evaluation_pool import PartialResults
from pretouch_simulation.evaluation_progress import run_with_progress
from pretouch_simulation.evaluation_protocol import Protocol
from pretouch_simulation.evaluation_rows import Run
from pretouch_simulation.evaluation_summary import group_by_setup, states_after, summaries
from pretouch_simulation.evaluation_table import honesty_table, tabulate_by_scan
from pretouch_simulation.evaluation_tasks import MeshTask
from pretouch_simulation.finger import FingerModel
from pretouch_simulation.mesh import load_mesh
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.protocol import make_case
from pretouch_simulation.reliability import LEVELS, compute_observed_shares, save_expected_errors, save_reliability
from pretouch_simulation.split import Split
from pretouch_simulation.worst import diagnose, worst_runs
from pretouch_simulation.worst_picture import Failure, save_worst
from rich.console import Console

from experiments.command_line import command_of, run_resumable
from experiments.folders import SHARED
from pretouch.session import Planner, Proposer

ENGINES = [*(engine for engine in Engine if engine is not Engine.POSTERIOR), Engine.POSTERIOR]
SCANS_REPORTED, SCANS_DRAWN, SCANS_FAILED = (0, 1, 2, 3, 5), (1, 2, 4), (1, 3)
"""Numbers of scans after which the tables, the pictures and the worst runs are evaluated."""
WORST = 5
SENSORS = (FingerModel.IDEAL, FingerModel.VL6180X)
PEER = "point_to_plane"
"""The engine with which the last one is compared by object."""


@dataclass(frozen=True)
class Part:
    """One folder of the experiment; `tasks` are its meshes' views."""

    name: str
    title: str
    tasks: list[MeshTask]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", type=Path, default=SHARED / "data" / "meshes" / "train")
    parser.add_argument("--split", type=Split, choices=list(Split), default=Split.VALIDATION)
    parser.add_argument("--limit", type=int, default=40)
    parser.add_argument("--analogues", type=Path, default=SHARED / "data" / "meshes" / "table1")
    parser.add_argument("--views", type=int, default=4)
    parser.add_argument("--scans", type=int, default=5)
    parser.add_argument("--engines", type=Engine, nargs="+", choices=list(Engine), default=ENGINES)
    parser.add_argument("--sensors", type=FingerModel, nargs="+", choices=list(FingerModel), default=SENSORS)
    parser.add_argument("--shared-scans", action="store_true", help="all engines match the scans that the last plans")
    run_resumable(parser, run)


def run(arguments: argparse.Namespace) -> None:
    """Runs both folders and writes everything into `arguments.out`."""
    engines, sensors, views = arguments.engines, arguments.sensors, arguments.views
    first = Protocol(
        scans=arguments.scans,
        proposer=Proposer.RANDOM,
        engine=engines[-1],
        planner=Planner.INFORMATION,
        sensor=sensors[0],
        seed=0,
        leader=engines[-1] if arguments.shared_scans and len(engines) > 1 else None,
    )
    protocols = [replace(first, engine=engine, sensor=sensor) for sensor in sensors for engine in engines]
    chosen = meshes_in(arguments.meshes, limit=arguments.limit, split=arguments.split)
    parts = [
        Part(
            "validation",
            f"Training meshes, side {arguments.split}",
            [MeshTask(p, v) for p in chosen for v in range(views)],
        ),
        Part(
            "analogues",
            "Analogues of the paper's Table 1",
            [MeshTask(path, view) for path in meshes_in(arguments.analogues) for view in range(views)],
        ),
    ]
    out: Path = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    texts, content, partials = [_introduction(arguments)], {}, []
    for part in parts:
        kept = PartialResults(out / f"registration-{part.name}", first, "--out")
        known, started = len(kept.runs), time.perf_counter()
        runs = run_with_progress(part.tasks, protocols, arguments.workers, kept, Console(stderr=True), part.name)
        if made := len(kept.runs) - known:
            pace = (time.perf_counter() - started) / made
            print(f"{part.name}: {made} runs, {pace:.2f} s of wall clock each")
        text, content[part.name] = _write_results(part, runs, first, out)
        texts.append(text)
        partials.append(kept)
    command = command_of("registration")
    (out / "registration.json").write_text(json.dumps({"command": command, "seed": 0, "parts": content}) + "\n")
    (out / "registration.md").write_text("\n".join(texts))
    for kept in partials:
        kept.remove()
    print("\n".join(texts))


def _introduction(arguments: argparse.Namespace) -> str:
    how = (
        f"All engines match the same scans, planned by the estimates of `{arguments.engines[-1]}`; `ms` is the match's."
        if arguments.shared_scans
        else "Each engine drives its own sessions; `ms` is from a scan's samples to the next plan, opening included."
    )
    command = command_of("registration")
    return (
        "# What the registrar is worth\n\n"
        f"`{command}`, seed 0: proposer `random`, planner `information`. {how} Errors are the mean distance of the "
        "object's points from their true place, in cm; `covered`: how often the truth lies in the stated 95 % region; "
        "`expected`: what the engine itself says of its error. A run that stopped counts with its last state.\n"
    )


def _write_results(part: Part, runs: Sequence[Run], protocol: Protocol, out: Path) -> tuple[str, dict[str, Any]]:
    """Writes the part's pictures; its section of the report, and its content for programs."""
    reported = [scan for scan in SCANS_REPORTED if scan <= protocol.scans]
    drawn = [scan for scan in SCANS_DRAWN if scan <= protocol.scans]
    engines = list(dict.fromkeys(setup.engine for setup in group_by_setup(runs)))
    meshes = len({run.mesh for run in runs})
    lines = [
        f"## {part.title}\n",
        f"{meshes} objects, {len(part.tasks)} views.\n",
        tabulate_by_scan(runs, reported).to_markdown(),
    ]
    lines.append(f"### Truth in the stated regions\n\n{honesty_table(runs, reported).to_markdown()}")
    lines += [f"Failed: {run.mesh}, view {run.view}, {run.engine}: {run.problem}\n" for run in runs if run.problem]
    subject = engines[-1]
    objects: dict[str, Any] = {}
    for other in engines[:-1]:
        pairs = compare_engines(runs, reported[-1], subject, other)
        objects[other] = [asdict(pair) for pair in pairs]
        if other == (PEER if PEER in engines[:-1] else engines[-2]):
            lines.append(f"### By object, after scan {reported[-1]}\n\n{comparison_table(pairs, subject, other)}")
    pictures = {"reliability": save_reliability, "expected": save_expected_errors}
    titles = {"reliability": "Stated regions", "expected": "Stated errors"}
    for name, save in pictures.items():
        path = out / f"registration-{part.name}-{name}.png"
        save(runs, drawn, f"{titles[name]}: {part.title}", path)
        lines.append(f"![{titles[name]}]({path.name})\n")
    lines += _picture_failures(part, [run for run in runs if run.engine == subject], protocol, out)
    content = {
        "summaries": [_finite(asdict(one)) for one in summaries(runs, reported)],
        "honesty": [asdict(one) for one in honesty(runs, reported)],
        "reliability": _reliability(runs, drawn),
        "compared": {"engine": subject, "after": reported[-1], "with": objects},
    }
    return "\n".join(lines), content


def _reliability(runs: Sequence[Run], scans: Sequence[int]) -> list[dict[str, Any]]:
    found = []
    for setup, group in group_by_setup(runs).items():
        for scan in scans:
            distances2 = [detail.distance2 for _, detail in states_after(group, scan)]
            if distances2:
                shares = dict(
                    zip(LEVELS.round(2).tolist(), compute_observed_shares(distances2).round(4).tolist(), strict=True)
                )
                found.append({**asdict(setup), "scan": scan, "n": len(distances2), "shares": shares})
    return found


def _picture_failures(part: Part, runs: Sequence[Run], protocol: Protocol, out: Path) -> list[str]:
    """Draws the worst runs, which are repeated for it, with their likely causes."""
    lines = ["### The worst runs\n"]
    paths = {task.mesh: task.path for task in part.tasks}
    for sensor in dict.fromkeys(run.sensor for run in runs):
        for scan in (scan for scan in SCANS_FAILED if scan <= protocol.scans):
            failures = []
            for one in worst_runs([run for run in runs if run.sensor == sensor], scan, WORST):
                case = make_case(one.mesh, load_mesh(paths[one.mesh]), one.view, protocol.seed, camera=protocol.camera)
                engine = Engine(one.engine)
                steps = run_steps(case, replace(protocol, engine=engine, sensor=FingerModel(sensor)), scan)
                record = steps[-1].record
                title = f"{one.mesh}, view {one.view}"
                failures.append(Failure(title, case, record, diagnose(case, record, engine)))
            if failures:
                path = out / f"registration-{part.name}-worst-{sensor}-{scan}.png"
                save_worst(failures, f"{part.title}: the worst runs, {sensor}, after scan {scan}", path)
                lines += [f"{sensor}, after scan {scan} ([picture]({path.name})):\n"]
                lines += [
                    f"- {one.title}: {100 * one.diagnosis.error:.2f} cm, expected "
                    f"{100 * one.diagnosis.expected_error:.2f} cm, d2 = {one.diagnosis.distance2:.1f}: "
                    f"{one.diagnosis.reason}"
                    for one in failures
                ]
                lines.append("")
    return lines


def _finite(values: dict[str, Any]) -> dict[str, Any]:
    """NaN is not JSON: null stands for it."""
    return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in values.items()}


if __name__ == "__main__":
    main()
