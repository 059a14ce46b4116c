"""How long Algorithm 1 takes to label an image, beside PCL, and how that grows.

`python -m benchmarks.label_throughput --json OUT [--images N] [--meshes DIR] [--rectangles R] [--trials T]
[--threads K] [--pcl DIR]` writes OUT and, beside it, OUT.png and OUT.md.

The images are the labels' own views (Kinect noise, 640x480, cropped), of the meshes of DIR or else of objects made in
code. Timed is what labels one image once its rectangles are drawn: all scores, and only the best rectangle. PCL (ICP
with its rejector VarTrimmed, which engine `pcl` follows to the letter) matches some of the same trials' points on one
core, the target's search tree built anew each time; its time an image is that of a match times the matches, divided by
the threads, cutting out the points not counted. Without PCL's headers it is left out and the reason said. CPU seconds
are all threads' together and tell more than wall seconds while something else runs.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from pretouch_detector.proposals.random import draw_rectangles
from pretouch_detector.training.trials import NOISE, draw_offsets, view_of
from pretouch_registrar.engines import camera_model
from pretouch_registrar.engines.label_trials import Matching, TrialSettings, compute_scores, find_best
from pretouch_simulation.labels.task import tasks_of
from pretouch_simulation.labels.view import view_of as seen_by_a_session
from pretouch_simulation.mesh_folder import meshes_in

from benchmarks import registration_peers as peers
from benchmarks.registration import REFERENCE, find_shared_peers
from benchmarks.registration_cases import RegistrationCase
from pretouch.camera import Camera, DepthImage
from pretouch.errors import PretouchError
from pretouch.geometry import Array, Pose
from pretouch.rectangle import RotatedRectangle
from pretouch.scene import Scene

ENGINES = (Matching.PAPER, Matching.POINT_TO_PLANE, Matching.PCL)
RECTANGLES, TRIALS = (125, 250, 500, 1000, 2000), (2, 5, 10, 20, 40)
FIXED_RECTANGLES = 250
"""Rectangles while trials or the image grow."""
FINENESS = (0.25, 1 / 3, 0.5, 1.0, 2.0)
"""Pixels along a side, to the original's."""
_PCL_MATCHES, _LEAST = 60, 30
"""Of an image that PCL is given, and the points that each of the two sides must have."""
_SEED = 0


@dataclass(frozen=True)
class Cost:
    """Seconds an image, on the wall and of all processors together."""

    wall: float
    cpu: float


def measure(scenes: Sequence[Scene], rectangles: int, trials: int, threads: int) -> list[dict[str, Any]]:
    """A row for each engine: the mean cost of all scores, and of the best alone."""
    rows = []
    for matching in ENGINES:
        both: dict[str, list[Cost]] = {"all": [], "best": []}
        for k, scene in enumerate(scenes):
            run = _image(scene, rectangles, trials, matching, threads, np.random.default_rng([_SEED, k]))
            if k == 0:
                for what in both:
                    _image(scene, 20, 2, matching, threads, np.random.default_rng(_SEED))[what]()
            for what, costs in both.items():
                costs.append(_time_run(run[what]))
        row: dict[str, Any] = {"engine": matching.name.lower()}
        for what, costs in both.items():
            row |= {f"{what} wall s": _mean(c.wall for c in costs), f"{what} cpu s": _mean(c.cpu for c in costs)}
        rows.append(row)
        print(row, flush=True)
    return rows


def measure_growth(scene: Scene, threads: int) -> dict[str, list[dict[str, Any]]]:
    """Costs by engine `paper` on one image as rectangles, trials and pixels grow."""

    def one(view: Scene, rectangles: int, trials: int, size: float) -> dict[str, Any]:
        run = _image(view, rectangles, trials, Matching.PAPER, threads, np.random.default_rng(_SEED))
        costs = {what: asdict(_time_run(run[what])) for what in ("all", "best")}
        print(f"{rectangles} rectangles, {trials} trials, {int(view.mask.sum())} pixels: {costs}", flush=True)
        return {"size": size, **costs}

    finer = [_resample(scene, share) for share in FINENESS]
    return {
        "rectangles": [one(scene, n, 10, n) for n in RECTANGLES],
        "trials": [one(scene, FIXED_RECTANGLES, n, n) for n in TRIALS],
        "pixels of the object": [one(view, FIXED_RECTANGLES, 10, float(view.mask.sum())) for view in finer],
    }


def pcl_seconds(scenes: Sequence[Scene], folder: Path) -> float:
    """Seconds of one match by PCL, the mean over some trials of each image.

    Raises:
        Missing: PCL's program cannot be built or run.
    """
    cases = [case for k, scene in enumerate(scenes) for case in _cases(scene, np.random.default_rng([_SEED, k]))]
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "cases.bin"
        peers.write_cases(cases, file)
        seconds, _ = peers.pcl(file, 3, folder, (REFERENCE,))[REFERENCE]
    return float(np.mean(seconds))


def _image(
    scene: Scene, rectangles: int, trials: int, matching: Matching, threads: int, rng: np.random.Generator
) -> dict[str, Callable[[], object]]:
    boxes, moves = draw_rectangles(scene, rectangles, rng), draw_offsets(trials, rng)
    view, how = view_of(scene, matching), TrialSettings(matching, NOISE)
    return {
        "all": lambda: compute_scores(view, boxes, moves, how, threads),
        "best": lambda: find_best(view, boxes, moves, how, threads),
    }


def _cases(scene: Scene, rng: np.random.Generator) -> Iterator[RegistrationCase]:
    """Points of trials as the kernels cut them out, in the camera's frame."""
    boxes, moves = draw_rectangles(scene, _PCL_MATCHES, rng), draw_offsets(_PCL_MATCHES, rng)
    cloud = scene.camera.back_project_image(scene.depth.metres)[scene.mask]
    seen, centre = scene.camera.project(cloud), cloud.mean(axis=0)
    model, how = camera_model.build(scene), TrialSettings()
    for box, move in zip(boxes, moves, strict=True):
        turn = Pose.from_rotation_vector(move[:3], (0, 0, 0))
        truth = Pose.of(turn.rotation, centre + move[3:] - turn.apply(centre))
        rectangle, moved = RotatedRectangle(*box), truth.apply(cloud)
        source = moved[np.abs(rectangle.distance(scene.camera.project(moved))) <= how.on]
        target = cloud[np.abs(rectangle.distance(seen)) <= how.near]
        if min(len(source), len(target)) >= _LEAST:
            noisy = source + rng.normal(0, NOISE, source.shape)
            yield RegistrationCase("", noisy, target, np.zeros_like(target), truth.inverse(), model)


def _resample(scene: Scene, share: float) -> Scene:
    """The same view with `share` times the pixels along each side."""
    h, w = scene.mask.shape
    v = np.arange(int(h * share)) / share
    u = np.arange(int(w * share)) / share
    pick = np.ix_(v.astype(np.intp), u.astype(np.intp))
    c = scene.camera
    camera = Camera(c.fx * share, c.fy * share, c.cx * share, c.cy * share)
    return Scene(DepthImage(scene.depth.metres[pick]), camera, scene.base_T_camera, scene.mask[pick], scene.table)


def _time_run(run: Callable[[], object]) -> Cost:
    wall, cpu = time.perf_counter(), time.process_time()
    run()
    return Cost(time.perf_counter() - wall, time.process_time() - cpu)


def _mean(values: Iterator[float]) -> float:
    return float(np.mean(list(values)))


def _scenes(count: int, folder: Path | None) -> list[Scene]:
    """The first views that can be labelled."""
    scenes: list[Scene] = []
    for task in tasks_of(meshes_in(folder) if folder else [], 0 if folder else count + 4, 1, 1):
        try:
            scenes.append(seen_by_a_session(task.case(_SEED)).scene)
        except PretouchError as error:
            print(f"skipped  {task.name}: {error}", flush=True)
        if len(scenes) == count:
            break
    return scenes


def format_document(document: dict[str, Any]) -> str:
    """The tables."""
    figures = ("all wall s", "best wall s", "all cpu s", "best cpu s")
    pcl = document["pcl s an image"]
    heads = ["engine", *figures] + (["PCL's time / all", "PCL's time / best"] if pcl else [])
    lines = [
        f"# Labelling by Algorithm 1: {document['rectangles']} rectangles x {document['trials']} trials",
        "",
        f"Mean of {document['images']} images of {document['object pixels']:.0f} object pixels, {document['threads']} "
        f"threads, load {document['load']:.1f} when begun. `{document['command']}`",
        f"PCL's own matching: {pcl:.1f} s an image." if pcl else f"Skipped: {document['skipped']}",
        "",
        f"| {' | '.join(heads)} |",
        "|---" * len(heads) + "|",
    ]
    for row in document["rows"]:
        cells = [row["engine"], *(f"{row[name]:.2f}" for name in figures)]
        cells += [f"{pcl / row[name]:.1f}" for name in figures[:2]] if pcl else []
        lines.append(f"| {' | '.join(cells)} |")
    for what, points in document["growth"].items():
        lines += ["", f"| {what} | all, cpu s | best, cpu s |", "|---|---|---|"]
        lines += [f"| {p['size']:.0f} | {p['all']['cpu']:.2f} | {p['best']['cpu']:.2f} |" for p in points]
    return "\n".join(lines) + "\n"


def picture(growth: dict[str, list[dict[str, Any]]]) -> Figure:
    """CPU seconds against each size."""
    figure = Figure(figsize=(13, 4.2), layout="constrained")
    for axes, (what, points) in zip(figure.subplots(1, len(growth), sharey=True), growth.items(), strict=True):
        sizes = [p["size"] for p in points]
        for kind, label in (("all", "all scores"), ("best", "the best only")):
            seconds: Array = np.array([p[kind]["cpu"] for p in points])
            slope = np.polyfit(np.log(sizes), np.log(np.maximum(seconds, 1e-4)), 1)[0]
            axes.loglog(sizes, seconds, "o-", label=f"{label}: slope {slope:.2f}")
        axes.set(xlabel=what, title=f"Time against {what}")
        axes.set_xticks(sizes, [f"{size:.0f}" for size in sizes])
        axes.xaxis.set_minor_formatter("")
        axes.grid(which="both", alpha=0.3)
        axes.legend()
    figure.axes[0].set_ylabel("CPU s an image, engine paper")
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, required=True)
    parser.add_argument("--images", type=int, default=6)
    parser.add_argument("--meshes", type=Path)
    parser.add_argument("--rectangles", type=int, default=1000)
    parser.add_argument("--trials", type=int, default=10)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument(
        "--pcl", type=Path, default=find_shared_peers(), help="folder with PCL's bench.cpp and build.sh"
    )
    options = parser.parse_args()
    load = os.getloadavg()[0]
    scenes = _scenes(options.images, options.meshes)
    try:
        per_match, skipped = pcl_seconds(scenes, options.pcl), ""
    except peers.Missing as missing:
        per_match, skipped = 0.0, str(missing)
        print(f"skipped  {missing}", flush=True)
    document = {
        "command": f"python -m benchmarks.label_throughput {shlex.join(sys.argv[1:])}",
        "seed": _SEED,
        "images": len(scenes),
        "object pixels": float(np.mean([scene.mask.sum() for scene in scenes])),
        "rectangles": options.rectangles,
        "trials": options.trials,
        "threads": options.threads,
        "load": load,
        "pcl ms a match": 1000 * per_match or None,
        "pcl s an image": per_match * options.rectangles * options.trials / options.threads or None,
        "skipped": skipped,
        "rows": measure(scenes, options.rectangles, options.trials, options.threads),
        "growth": measure_growth(scenes[0], options.threads),
    }
    options.json.parent.mkdir(parents=True, exist_ok=True)
    options.json.write_text(json.dumps(document, indent=1) + "\n")
    options.json.with_suffix(".md").write_text(format_document(document))
    picture(document["growth"]).savefig(options.json.with_suffix(".png"), dpi=120)
    print(format_document(document))


if __name__ == "__main__":
    main()
