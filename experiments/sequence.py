"""Error against the share of the object scanned: the paper's Figs. 5 and 6, also for other planners.

    python -m experiments.sequence [--meshes DIR] [--proposers random narf stability deep] [--views 1] [--scans 6]
        [--planners confidence information] [--sensor ideal|vl6180x|cone|random] [--pictures 3] [--out docs/results]

Whole sessions by the evaluation protocol, engine `posterior`: scans in the order of the proposer's confidence, as in
the paper, beside the order by what the registrar predicts (PredictScans). Writes sequence.md, sequence.json,
sequence.png and, of the first meshes, sequence-clouds.png. DIR is data/meshes/table1 of PRETOUCH_SHARED unless given. A
run that was stopped goes on when it is started again.
"""

from __future__ import annotations

import argparse
import json
import math
import os
from collections.abc import Sequence
from pathlib import Path

from pretouch_simulation.evaluation import Step, run_steps, warm_up
from pretouch_simulation.finger import FingerModel
from pretouch_simulation.markdown import markdown_table
from pretouch_simulation.mesh import load_mesh
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.partial_rows import PartialRows
from pretouch_simulation.protocol import Case, make_case
from pretouch_simulation.split import Split
from pretouch_simulation.workers import run_in_workers
from rich.console import Console
from rich.progress import track

from experiments.collecting import PROPOSERS, split_by_readiness
from experiments.command_line import command_of, run_resumable
from experiments.folders import SHARED
from experiments.sequence_picture import save_clouds, save_curves
from experiments.sessions import Course, errors_at, means_after_scan, protocol_of, run_session, share_to_reach
from pretouch.errors import InvalidInput
from pretouch.session import Planner, Proposer

_SHARES = (0.05, 0.10, 0.15, 0.20, 0.30)
_SECONDS_A_SCAN = 1.2
"""s of one core for registering a scan and predicting the next one."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", type=Path, default=SHARED / "data" / "meshes" / "table1")
    parser.add_argument("--split", type=Split, choices=list(Split))
    parser.add_argument("--limit", type=int)
    parser.add_argument("--proposers", type=Proposer, nargs="+", choices=list(Proposer), default=list(PROPOSERS))
    parser.add_argument(
        "--planners", type=Planner, nargs="+", choices=list(Planner), default=[Planner.CONFIDENCE, Planner.INFORMATION]
    )
    parser.add_argument("--views", type=int, default=1)
    parser.add_argument("--scans", type=int, default=6)
    parser.add_argument("--sensor", type=FingerModel, choices=list(FingerModel), default=FingerModel.IDEAL)
    parser.add_argument("--pictures", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    run_resumable(parser, run)


def run(arguments: argparse.Namespace) -> None:
    """Makes the sessions and writes everything into `arguments.out`."""
    if min(arguments.views, arguments.scans) < 1:
        raise InvalidInput("There is nothing to scan.", "Give at least one view and one scan.")
    proposers, missing = split_by_readiness(arguments.proposers)
    paths = meshes_in(arguments.meshes, limit=arguments.limit, split=arguments.split)
    out: Path = arguments.out
    settings = {"scans": arguments.scans, "sensor": arguments.sensor.value, "seed": arguments.seed}
    kept = PartialRows(out / "sequence.partial", settings)
    courses = _run_sessions(arguments, proposers, paths, kept)
    command = command_of("sequence")
    content = {
        **{"command": command, "seed": arguments.seed, "sensor": arguments.sensor.value, "not_ready": missing},
        "rows": [course.as_dict() for course in courses],
    }
    (out / "sequence.json").write_text(json.dumps(content) + "\n")
    good = [course for course in courses if course.initial is not None]
    about = f"{len(paths)} objects x {arguments.views} views, {arguments.sensor} finger, engine posterior"
    title = f"{about}, seed {arguments.seed}"
    text = f"# Error against the share of the object scanned\n\nMade by `{command}`: {title}.\n\n{format_table(good)}"
    text += "\n![Error against the share scanned](sequence.png)\n"
    save_curves(good, arguments.scans, title, out / "sequence.png")
    if arguments.pictures:
        name = f"scans by {proposers[-1]}, in the order of its confidence (grey: the true object)"
        save_clouds(_run_pictured_sessions(arguments, proposers[-1], paths), name, out / "sequence-clouds.png")
        text += "\n![Clouds and scans](sequence-clouds.png)\n"
    text += "".join(f"\n`{name}` is left out: {reason}\n" for name, reason in missing.items())
    failed = [course for course in courses if course.problem]
    text += "".join(f"\nFailed: {one.mesh}, view {one.view}, {one.proposer}: {one.problem}\n" for one in failed)
    (out / "sequence.md").write_text(text)
    kept.remove()
    print(text)


def _run_sessions(
    arguments: argparse.Namespace, proposers: Sequence[Proposer], paths: Sequence[Path], kept: PartialRows
) -> list[Course]:
    found = {course.key: course for course in map(Course.from_dict, kept.rows)}
    wanted = {
        (path.stem, view, proposer.value, planner.value): (path, view, proposer, planner)
        for view in range(arguments.views)
        for path in paths
        for proposer in proposers
        for planner in arguments.planners
    }
    calls = [
        (*call, protocol_of(*call[2:], arguments.scans, arguments.sensor, arguments.seed))
        for key, call in wanted.items()
        if key not in found
    ]
    workers = arguments.workers or os.cpu_count() or 1
    console = Console(stderr=True)
    seconds = len(calls) * (1 + arguments.scans * _SECONDS_A_SCAN) / workers
    console.print(f"sessions: {len(calls)} of {len(wanted)} to do, about {seconds:.0f} s in {workers} processes")
    first = protocol_of(proposers[0], arguments.planners[0], 1, arguments.sensor, arguments.seed)
    made = run_in_workers(run_session, calls, workers, warm_up, ([first],))
    for course in track(made, "sessions", total=len(calls), console=console):
        kept.add(course.as_dict())
        found[course.key] = course
    return [found[key] for key in wanted]


def _run_pictured_sessions(
    arguments: argparse.Namespace, proposer: Proposer, paths: Sequence[Path]
) -> list[tuple[str, Case, list[Step]]]:
    """Repeats sessions on the first meshes, to be drawn."""
    protocol = protocol_of(proposer, Planner.CONFIDENCE, arguments.scans, arguments.sensor, arguments.seed)
    sessions = []
    for path in track(paths[: arguments.pictures], "pictures", console=Console(stderr=True)):
        case = make_case(path.stem, load_mesh(path), 0, arguments.seed, camera=protocol.camera)
        sessions.append((f"{path.stem}, view 0", case, run_steps(case, protocol, arguments.scans)))
    return sessions


def format_table(courses: Sequence[Course]) -> str:
    """A line for each proposer and planner; errors in cm."""
    shares = [f"{share:.0%} scanned" for share in _SHARES]
    scans = [scan for scan in (1, 2, 3, 5) if any(len(course.errors) >= scan for course in courses)]
    headings = ["order", "proposer", "n", "before", *shares, "0.5 cm at", "0.2 cm at"]
    headings += [f"scan {scan}: cm at %" for scan in scans]
    lines = []
    for planner, proposer in dict.fromkeys((course.planner, course.proposer) for course in courses):
        group = [course for course in courses if (course.planner, course.proposer) == (planner, proposer)]
        cells = [planner, proposer, str(len(group))]
        cells += [f"{100 * error:.2f}" for error in errors_at(group, [0.0, *_SHARES]).mean(axis=0)]
        cells += [_share(share_to_reach(group, level)) for level in (0.005, 0.002)]
        cells += [
            f"{100 * error:.2f} at {100 * share:.0f}" for share, error in (means_after_scan(group, k) for k in scans)
        ]
        lines.append(cells)
    note = (
        "Mean error in cm. At a share scanned: after the last scan that does not exceed it, so that a session whose "
        "first scan covers more counts with its error before; a session that ended keeps its last. `0.5 cm at`: the "
        "least share at which the mean is that low."
    )
    return f"{markdown_table(headings, lines)}\n{note}\n"


def _share(value: float) -> str:
    return "–" if math.isnan(value) else f"{100 * value:.1f} %"


if __name__ == "__main__":
    main()
