"""Proposers on real depth frames, on which nothing was trained or tuned.

    python -m experiments.transfer [--frames DIR] [--scenes DIR] [--proposers random narf stability deep] [--offsets 4]
        [--settings real paper] [--sensor ideal|vl6180x|cone|random] [--candidates 0] [--sheet 12] [--out docs/results]

With ground truth (`--frames`, data/real_depth/ycb_video of PRETOUCH_SHARED unless given): the first and the last frame
of each video, every object with more than 1000 pixels of depth; each of a proposer's first ten rectangles is scanned
alone, as by table1. Without (`--scenes`, data/real_depth/mosd_kinect_v1): proposals only, a contact sheet for each
proposer. Writes transfer.md, transfer.json, transfer.png and transfer-<proposer>.png. A run that was stopped goes on
when it is started again.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
from pretouch_simulation.evaluation_tasks import MIN_PIXELS
from pretouch_simulation.finger import FingerModel, realise
from pretouch_simulation.frames import load_frame
from pretouch_simulation.labels.frame_task import FrameTask, frame_tasks
from pretouch_simulation.partial_rows import PartialRows
from pretouch_simulation.protocol import generator
from pretouch_simulation.split import compute_mixing_key
from rich.console import Console
from rich.progress import track

from experiments.collecting import PROPOSERS, jobs_of, run_jobs, split_by_readiness
from experiments.command_line import command_of, run_resumable
from experiments.folders import SHARED
from experiments.one_scan import PAPER, Job, Target, propose_first
from experiments.one_scan_picture import save
from experiments.one_scan_text import section
from experiments.proposals_picture import Proposed, save_sheet
from pretouch.errors import InvalidInput, NotFound, PretouchError
from pretouch.scene import Scene
from pretouch.session import Proposer

FIRST = 10
DRAWN = 5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=Path, default=SHARED / "data" / "real_depth" / "ycb_video")
    parser.add_argument("--scenes", type=Path, default=SHARED / "data" / "real_depth" / "mosd_kinect_v1")
    parser.add_argument("--proposers", type=Proposer, nargs="+", choices=list(Proposer), default=list(PROPOSERS))
    parser.add_argument("--offsets", type=int, default=4)
    parser.add_argument("--settings", nargs="+", choices=("real", PAPER), default=["real", PAPER])
    parser.add_argument("--sensor", type=FingerModel, choices=list(FingerModel), default=FingerModel.IDEAL)
    parser.add_argument("--candidates", type=int, default=0, help="0: no oracle")
    parser.add_argument("--sheet", type=int, default=12, help="views on a contact sheet")
    parser.add_argument("--seed", type=int, default=0)
    run_resumable(parser, run)


def run(arguments: argparse.Namespace) -> None:
    """Runs the jobs and writes everything into `arguments.out`."""
    if arguments.offsets < 1 or arguments.sheet < 1:
        raise InvalidInput("There is nothing to show.", "Give at least one offset and one view.")
    proposers, missing = split_by_readiness(arguments.proposers)
    out: Path = arguments.out
    settings = {"offsets": arguments.offsets, "seed": arguments.seed, "candidates": arguments.candidates}
    jobs = _jobs(arguments, proposers)
    kept = PartialRows(out / "transfer.partial", settings)
    rows = run_jobs(jobs, arguments.workers, kept, "real frames")
    command = command_of("transfer")
    content = {"commands": [command], "not_ready": missing, "rows": [row.as_dict() for row in rows]}
    (out / "transfer.json").write_text(json.dumps(content) + "\n")
    save(rows, out / "transfer.png")
    setups = list(dict.fromkeys(row.setup for row in rows))
    text = [f"# Real depth frames\n\nMade by `{command}`. Errors in cm. Frames with ground truth: YCB-Video.\n"]
    text += [section(rows, setup, missing) for setup in setups]
    text.append("![Errors by object](transfer.png)\n")
    text += _save_sheets(arguments, proposers, missing)
    (out / "transfer.md").write_text("\n".join(text))
    kept.remove()
    print("\n".join(text))


def frames_of(folder: Path) -> list[Path]:
    """The first and the last frame of each video, named by what comes before `_`: the views between hardly differ.

    Raises:
        NotFound: there are none.
    """
    files = sorted(folder.glob("*.json"))
    if not files:
        raise NotFound(f"There are no frames in {folder}.", "Give --frames, or set PRETOUCH_SHARED.")
    videos = [list(group) for _, group in groupby(files, key=lambda path: path.stem.partition("_")[0])]
    return [path for video in videos for path in dict.fromkeys((video[0], video[-1]))]


def _jobs(arguments: argparse.Namespace, proposers: Sequence[Proposer]) -> list[Job]:
    setups = [arguments.sensor.value if setting == "real" else PAPER for setting in arguments.settings]
    jobs = []
    for path in frames_of(arguments.frames):
        frame = load_frame(path)
        for thing in frame.objects:
            if frame.mask(thing.name).sum() > MIN_PIXELS:
                target = Target(path, 0, thing.name)
                for setup in setups:
                    jobs += jobs_of(
                        target, setup, proposers, arguments.offsets, arguments.seed, FIRST, arguments.candidates
                    )
    return jobs


def _save_sheets(arguments: argparse.Namespace, proposers: Sequence[Proposer], missing: dict[str, str]) -> list[str]:
    """Writes the contact sheets; the section that shows them."""
    views = _load_views(arguments.scenes, arguments.sheet)
    text = [
        "## Proposals on real scenes without ground truth\n",
        f"mOSD, Kinect v1: {len(views)} objects of as many frames, chosen by a hash of their names. The first {DRAWN} "
        "regions, red the best; white: the object's outline; dark: no depth.\n",
    ]
    for proposer in track(proposers, "contact sheets", console=Console(stderr=True)):
        shown, times = [], []
        for task, scene in views:
            started = time.perf_counter()
            sensor = realise(arguments.sensor, generator("finger-model", arguments.seed, task.name)).sensor
            regions = propose_first(scene, proposer, sensor, FIRST)
            times.append(time.perf_counter() - started)
            best = f", best {regions[0].confidence:.2f}" if regions else ""
            shown.append(Proposed(f"{task.name}: {len(regions)} regions{best}", scene, regions[:DRAWN]))
        path = arguments.out / f"transfer-{proposer}.png"
        save_sheet(shown, f"{proposer}: the first {DRAWN} regions, red the best", path)
        few = sum(len(one.regions) < DRAWN for one in shown)
        text.append(
            f"{proposer}: median {1000 * float(np.median(times)):.0f} ms a view; fewer than {DRAWN} regions on {few} "
            f"of {len(shown)} views\n\n![{proposer}]({path.name})\n"
        )
    return text + [f"`{name}` is left out: {reason}\n" for name, reason in missing.items()]


def _load_views(folder: Path, count: int) -> list[tuple[FrameTask, Scene]]:
    """One object each of `count` frames, in an order fixed by the names; frames without an object are skipped."""
    tasks = sorted(
        frame_tasks(folder), key=lambda task: (compute_mixing_key(task.file.stem), compute_mixing_key(task.name))
    )
    found: list[tuple[FrameTask, Scene]] = []
    for _, group in groupby(tasks, key=lambda task: task.file):
        for task in group:
            try:
                found.append((task, task.scene(0)[0]))
            except PretouchError:
                continue
            break
        if len(found) == count:
            break
    return found


if __name__ == "__main__":
    main()
