"""NARF beside PCL on simulated depth images: do borders, complete interest image, keypoints and descriptors agree?

`python -m benchmarks.narf [--meshes DIR] [--images N] [--support M] [--whole] [--json OUT]`

The images are the evaluation's (Kinect noise, one view of each mesh in turn; without --meshes of the objects made in
code), cropped to the object and 8 cm around it, as the orchestrator does, or the whole 640 x 480 pixels. PCL is
Debian's, through `pcl/narf_oracle.cpp`; both compute every pixel's interest, on one core. Then the time of the proposer
on the whole images, which looks at the object only.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pretouch_detector.proposals import narf, warm_up
from pretouch_detector.proposals.narf.borders import find_borders
from pretouch_detector.proposals.narf.change import measure_change
from pretouch_detector.proposals.narf.descriptor import describe_keypoints
from pretouch_detector.proposals.narf.interest import compute_interest
from pretouch_detector.proposals.narf.keypoints import find_keypoints
from pretouch_detector.proposals.narf.range_image import make_range_image
from pretouch_detector.proposals.narf.surface import fit_surface
from pretouch_simulation.mesh import load_mesh
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import TABLE, make_case

from benchmarks.narf_oracle import Answer, Floats, Missing, Question, ask, build
from pretouch.scene import Scene
from pretouch.tof import Sensor

AGREES = 1e-3
_MARGIN = 0.08
_SECONDS_AN_IMAGE = 120.0


@dataclass(frozen=True)
class Agreement:
    """Ours against PCL's on one image; differences are the largest absolute ones.

    Attributes:
        pixels: of the image; apart: of them, those whose interest differs by more than AGREES.
        scores, change, interest: of the border scores (first and final), the surface change, the interest.
        classes: pixels that are obstacle border towards a side, shadow border or veil point for one of us only.
        keypoints, ours, shared: PCL's, ours, and those at the same pixel with the same interest within AGREES.
        descriptors: of the shared keypoints' elements.
        sparse_apart, sparse_shared: the same of PCL's own default, the sparse image, against its complete one.
        ms, pcl_ms: for all of it.
    """

    image: str
    pixels: int
    scores: float
    classes: int
    change: float
    interest: float
    apart: int
    keypoints: int
    ours: int
    shared: int
    descriptors: float
    sparse_apart: int
    sparse_keypoints: int
    sparse_shared: int
    ms: float
    pcl_ms: float


def views(count: int, folder: Path | None) -> list[tuple[str, Scene]]:
    """`count` named views of the meshes of `folder`, or of the objects made in code."""
    if folder is None:
        meshes = [(name, make()) for name, make in MAKERS.items()]
    else:
        meshes = [(path.stem, load_mesh(path)) for path in meshes_in(folder, limit=count)]
    chosen = []
    for k in range(count):
        name, mesh = meshes[k % len(meshes)]
        case = make_case(name, mesh, k // len(meshes))
        chosen.append((f"{name}-{case.view}", Scene(case.depth, case.camera, case.base_T_camera, case.mask, TABLE)))
    return chosen


def compare(name: str, question: Question, theirs: Answer) -> Agreement:
    """Our stages on the same image, every pixel's interest."""
    started = time.perf_counter()
    image = make_range_image(question.depth, question.camera)
    planes = fit_surface(image)
    found = find_borders(image, planes)
    changes = measure_change(image, planes, found)
    everywhere = np.ones(image.ranges.shape, np.bool_)
    values = compute_interest(image, changes, found.shadow | found.veil, everywhere, question.support)
    pixels = find_keypoints(values, image.points, question.support)
    described, _ = describe_keypoints(image, pixels, question.support)
    seconds = time.perf_counter() - started
    ours = np.concatenate([image.points, values[..., None]], axis=-1)[tuple(pixels.T)]
    mine, other = _match_keypoints(ours, theirs.keypoints)
    _, kept = _match_keypoints(theirs.sparse_keypoints, theirs.keypoints)
    classes = (found.obstacle != theirs.obstacle).any(axis=0) | (found.shadow != theirs.shadow)
    return Agreement(
        image=name,
        pixels=values.size,
        scores=max(
            _compute_difference(found.first_scores, theirs.first_scores),
            _compute_difference(found.scores, theirs.scores),
        ),
        classes=int((classes | (found.veil != theirs.veil)).sum()),
        change=max(
            _compute_difference(changes.scores, theirs.change),
            _compute_difference(changes.directions, theirs.directions),
        ),
        interest=_compute_difference(values, theirs.interest),
        apart=int((np.abs(values - theirs.interest) > AGREES).sum()),
        keypoints=len(theirs.keypoints),
        ours=len(pixels),
        shared=len(mine),
        descriptors=_compute_difference(
            described[mine], np.where(theirs.described[:, None], theirs.descriptors, np.nan)[other]
        ),
        sparse_apart=int((np.abs(theirs.sparse - theirs.interest) > AGREES).sum()),
        sparse_keypoints=len(theirs.sparse_keypoints),
        sparse_shared=len(kept),
        ms=1e3 * seconds,
        pcl_ms=theirs.ms,
    )


def _match_keypoints(a: Floats, b: Floats) -> tuple[list[int], list[int]]:
    """Which of the keypoints a (n, 4) and b (m, 4) are the same, as indices of both."""
    pairs = [
        (i, j) for i, p in enumerate(a) for j, q in enumerate(b)
        if np.array_equal(p[:3], q[:3]) and abs(p[3] - q[3]) <= AGREES
    ]  # fmt: skip
    return [i for i, _ in pairs], [j for _, j in pairs]


def _compute_difference(a: Floats, b: Floats) -> float:
    """The largest absolute difference; nan only where just one of the two is unknown."""
    differences = np.where(np.isnan(a) & np.isnan(b), 0.0, np.abs(a - b))
    return float(differences.max(initial=0.0))


def agreement(scenes: Sequence[tuple[str, Scene]], support: float, program: Path) -> list[Agreement]:
    """Ours and PCL's on each of the views."""
    questions = [Question(scene.depth, scene.camera, support) for _, scene in scenes]
    answers = ask(program, questions, _SECONDS_AN_IMAGE * len(questions))
    warm_up()
    return [compare(name, q, a) for (name, _), q, a in zip(scenes, questions, answers, strict=True)]


def proposer_times(scenes: Sequence[tuple[str, Scene]]) -> list[float]:
    """ms of each of the views."""
    warm_up()
    times = []
    for _, scene in scenes:
        started = time.perf_counter()
        narf.propose(scene, Sensor(), 20, np.random.default_rng(0))
        times.append(1e3 * (time.perf_counter() - started))
    return times


def report(rows: Sequence[Agreement], times: Sequence[float]) -> str:
    """The figures of all images, a line each, and then their summary."""
    form = "{:34}" + "{:>10}" * 14
    head = ("pixels", "scores", "classes", "change", "interest", "> 1e-3", "PCL's", "ours", "shared", "descr.")
    lines = [form.format("image", *head, "sparse: >", "shared", "ms", "PCL's")]
    for row in rows:
        differences = [f"{x:.1e}" for x in (row.scores, row.change, row.interest, row.descriptors)]
        numbers: list[object] = [row.pixels, differences[0], row.classes, differences[1], differences[2], row.apart]
        numbers += [row.keypoints, row.ours, row.shared, differences[3], row.sparse_apart, row.sparse_shared]
        lines.append(form.format(row.image[:33], *numbers, f"{row.ms:.0f}", f"{row.pcl_ms:.0f}"))

    def total(name: str) -> Any:
        return sum(getattr(row, name) for row in rows)

    def worst(name: str) -> str:
        return f"{max(getattr(row, name) for row in rows):.1e}"

    def format_share(name: str) -> str:
        return f"{100 * (1 - total(name) / total('pixels')):.4f} % of the pixels within {AGREES:g}"

    lines += [
        f"{len(rows)} images, {total('pixels')} pixels: border scores within {worst('scores')}, "
        f"{total('classes')} pixels of another class, change within {worst('change')}",
        f"complete interest image: within {worst('interest')}, {format_share('apart')}",
        f"keypoints: {total('shared')} of PCL's {total('keypoints')} shared, {total('ours') - total('shared')} of ours "
        f"not; descriptors of the shared within {worst('descriptors')}",
        f"PCL's sparse image against its complete one: {format_share('sparse_apart')}, {total('sparse_shared')} of its "
        f"{total('sparse_keypoints')} keypoints are the complete one's",
        f"all pixels: {total('ms'):.0f} ms, PCL {total('pcl_ms'):.0f} ms, ratio {total('pcl_ms') / total('ms'):.1f}",
        f"proposer on 640 x 480: median {np.median(times):.0f} ms, p95 {np.percentile(times, 95):.0f}, "
        f"worst {max(times):.0f}",
    ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", type=Path, help="a folder of meshes instead of the objects made in code")
    parser.add_argument("--images", type=int, default=24)
    parser.add_argument("--support", type=float, default=narf.SUPPORT, help="m")
    parser.add_argument("--whole", action="store_true", help="do not crop the images")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    with tempfile.TemporaryDirectory() as folder:
        try:
            program = build(Path(folder))
        except Missing as missing:
            sys.exit(str(missing))
        scenes = views(options.images, options.meshes)
        shown = scenes if options.whole else [(name, scene.cropped(_MARGIN)[0]) for name, scene in scenes]
        rows = agreement(shown, options.support, program)
    times = proposer_times(scenes)
    print(report(rows, times))
    if options.json:
        content = {"command": " ".join(sys.argv), "rows": [asdict(row) for row in rows], "proposer_ms": times}
        options.json.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
