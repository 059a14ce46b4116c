"""Sessions whose client describes the finger wrongly, or whose mask or depth image is wrong.

    python -m experiments.wrong_input [--meshes DIR] [--limit 20] [--seed 0] [--camera random] [--out docs/results]

Writes wrong-input.md. DIR is data/meshes/train of PRETOUCH_SHARED unless given; its side for reporting. A session has
the default budget and tolerance; the robot guards its scans, so that the finger gets returns.
"""

from __future__ import annotations

import argparse
import asyncio
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.depth_cameras.fields import smooth_field
from pretouch_simulation.evaluation import run_session
from pretouch_simulation.evaluation_honesty import SURE, WRONG
from pretouch_simulation.evaluation_protocol import Protocol, adapt_to_frames, finger_of
from pretouch_simulation.finger import Finger, FingerModel, Measurements
from pretouch_simulation.fingers.faults import make_stuck_module
from pretouch_simulation.markdown import markdown_table
from pretouch_simulation.mesh import load_mesh
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.protocol import Case, generator, make_case
from pretouch_simulation.split import Split
from rich.progress import track
from scipy import ndimage

from experiments.command_line import command_of
from experiments.folders import RESULTS, SHARED
from pretouch.camera import DepthImage
from pretouch.errors import TYPE_PREFIX, PretouchError, wire_of
from pretouch.geometry import Array, Pose
from pretouch.session import Planner, Proposer, Tolerance
from pretouch.tof import Sensor

Image = Callable[[Case], Case]
Hand = Callable[[Finger], Finger]


class Mistake(NamedTuple):
    """A mistake in a session with fingertip `model`."""

    name: str
    model: FingerModel = FingerModel.IDEAL
    hand: Hand = lambda finger: finger
    image: Image = lambda case: case


@dataclass(frozen=True)
class Misdescribed:
    """A `Finger` that is described as another sensor."""

    finger: Finger
    sensor: Sensor

    def begin_scan(self, count: int, rng: np.random.Generator) -> Measurements:
        """See `Finger.begin_scan`."""
        return self.finger.begin_scan(count, rng)


def misdescribe(std: float = 1.0, cone: float = 1.0) -> Hand:
    """Describes the finger with its standard deviation and half angle multiplied by these factors."""

    def describe(finger: Finger) -> Finger:
        sensor = finger.sensor
        return Misdescribed(
            finger,
            replace(sensor, range_std=std * sensor.range_std, beam_half_angle=cone * sensor.beam_half_angle),
        )

    return describe


def dilate_mask(pixels: int) -> Image:
    """The mask reaches so many pixels too far."""
    return lambda case: replace(case, mask=ndimage.binary_dilation(case.mask, iterations=pixels))


def shift_mask(pixels: int) -> Image:
    """The mask lies so many pixels to the right."""
    return lambda case: replace(case, mask=ndimage.shift(case.mask, (0, pixels), order=0))


def drop_left_half(case: Case) -> Case:
    """No depth on the left half of the object."""
    left = case.scored & (np.indices(case.mask.shape)[1] < np.median(np.nonzero(case.scored)[1]))
    return replace_depth(case, np.where(left, 0.0, case.depth.metres))


def drop_surroundings(case: Case) -> Case:
    """No depth but on the object."""
    return replace_depth(case, np.where(case.scored, case.depth.metres, 0.0))


def make_glass(share: float) -> Image:
    """The table is seen through about `share` of the object, in spots."""

    def seen_through(case: Case) -> Case:
        rng = generator("glass", case.name, case.view)
        base_T_camera = case.truth @ case.base_T_camera
        v, u = np.indices(case.mask.shape)
        rays = np.stack(
            [(u - case.camera.cx) / case.camera.fx, (v - case.camera.cy) / case.camera.fy, np.ones(v.shape)], -1
        )
        table = case.world.table
        down = rays @ (base_T_camera.rotation.T @ table.normal)
        behind = (table.offset - table.normal @ base_T_camera.translation) / down
        field = smooth_field(rng, case.mask.shape, 6.0)
        through = case.scored & (field < np.quantile(field[case.scored], share))
        return replace_depth(case, np.where(through, behind, case.depth.metres))

    return seen_through


def replace_depth(case: Case, metres: Array) -> Case:
    """The case with another image (h, w), m; the mask keeps only pixels with depth, as a client's does."""
    return replace(case, depth=DepthImage(metres.astype(np.float32)), mask=case.mask & (metres > 0))


IDEAL, CONE = FingerModel.IDEAL, FingerModel.CONE
MISTAKES = (
    Mistake("nothing, `ideal`"),
    Mistake("range_std stated a third", hand=misdescribe(std=1 / 3)),
    Mistake("range_std stated threefold", hand=misdescribe(std=3.0)),
    Mistake("one of six modules stuck", hand=make_stuck_module),
    Mistake("mask bleeds 3 px", image=dilate_mask(3)),
    Mistake("mask bleeds 5 px", image=dilate_mask(5)),
    Mistake("mask bleeds 8 px", image=dilate_mask(8)),
    Mistake("mask 8 px off", image=shift_mask(8)),
    Mistake("half of the object without depth", image=drop_left_half),
    Mistake("table seen through a half", image=make_glass(0.5)),
    Mistake("table seen through all", image=make_glass(1.0)),
    Mistake("depth on the object only", image=drop_surroundings),
    Mistake("nothing, `cone`", CONE),
    Mistake("half angle stated a half", CONE, misdescribe(cone=0.5)),
    Mistake("half angle stated double", CONE, misdescribe(cone=2.0)),
    Mistake("cone described as a thin beam", CONE, misdescribe(cone=0.0)),
    Mistake("range_std of the cone stated a third", CONE, misdescribe(std=1 / 3)),
)


class Ending(NamedTuple):
    """The end of a session: errors, m, whether its 95 % region holds the truth, and its state or reason."""

    initial: float
    error: float
    expected: float
    covered: bool
    said: str


def run_session_with(case: Case, mistake: Mistake, protocol: Protocol, registrar: Registrar) -> Ending | str:
    """Runs a session with the mistake; how it ends, or the error's title if it is refused."""
    protocol = replace(protocol, sensor=mistake.model)
    finger = mistake.hand(finger_of(case, protocol))
    initial = case.error(Pose.identity())
    try:
        steps = asyncio.run(run_session(mistake.image(case), protocol, registrar, finger=finger))
    except PretouchError as refusal:
        return wire_of(refusal).title
    if not steps:
        return "nothing to scan"
    record = steps[-1].record
    reason = (record.reason or {}).get("type", "").removeprefix(TYPE_PREFIX)
    estimate = record.estimate
    error = case.error(estimate.base_T_correction)
    return Ending(initial, error, estimate.expected_error, case.is_covered_by(estimate), reason or record.state.value)


def text(command: str, camera: str, rows: dict[str, list[Ending | str]], tolerance: float) -> str:
    """The page."""
    n = len(next(iter(rows.values())))
    lines = [
        "# Wrongly described fingers, wrong masks and images\n",
        f"Made by `{command}`: {n} meshes of the validation side, one view each by camera `{camera}`, sessions with "
        "the default budget and tolerance, proposer `random`, guarded scans. Errors in cm; *wrong and sure*: "
        f"above {100 * WRONG:g} with less than {100 * SURE:g} stated; *converged wrong*: said to be within "
        f"{1000 * tolerance:g} mm and not within it and 2 mm.\n",
    ]
    headings = (
        *("what is wrong", "sessions", "before", "final", "median", "stated", "truth in 95 %", "wrong and sure"),
        *("converged", "converged wrong", "ends"),
    )
    table = []
    for name, outcomes in rows.items():
        held = [one for one in outcomes if isinstance(one, Ending)]
        ends = Counter(one.said if isinstance(one, Ending) else f"refused: {one}" for one in outcomes)
        cells = [name, str(len(held))]
        if held:
            error, expected = (
                100 * np.array(column) for column in ([e.error for e in held], [e.expected for e in held])
            )
            said = np.array([one.said == "converged" for one in held])
            cells += [
                f"{100 * np.mean([one.initial for one in held]):.2f}",
                f"{error.mean():.2f}",
                f"{np.median(error):.2f}",
                f"{expected.mean():.2f}",
                f"{np.mean([one.covered for one in held]):.0%}",
                str(int(((error > 100 * WRONG) & (expected < 100 * SURE)).sum())),
                str(int(said.sum())),
                str(int((said & (error > 100 * tolerance + 0.2)).sum())),
            ]
        else:
            cells += ["-"] * 8
        cells.append(", ".join(f"{end} {count}" for end, count in ends.most_common()))
        table.append(cells)
    return "\n".join([*lines, markdown_table(headings, table)])


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--meshes", type=Path, default=SHARED / "data" / "meshes" / "train")
    parser.add_argument("--limit", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--camera", type=CameraModel, choices=list(CameraModel), default=CameraModel.RANDOM)
    parser.add_argument("--out", type=Path, default=RESULTS)
    given = parser.parse_args(arguments)
    protocol = adapt_to_frames(
        Protocol(10, Proposer.RANDOM, Engine.POSTERIOR, Planner.INFORMATION, IDEAL, given.seed, guarded=True), None
    )
    paths = meshes_in(given.meshes, limit=given.limit, split=Split.VALIDATION)
    registrar = Registrar()
    rows: dict[str, list[Ending | str]] = {mistake.name: [] for mistake in MISTAKES}
    for path in track(paths, "Sessions"):
        case = make_case(path.stem, load_mesh(path), 0, given.seed, given.camera)
        for mistake in MISTAKES:
            rows[mistake.name].append(run_session_with(case, mistake, protocol, registrar))
    command = command_of("wrong_input", arguments)
    page = text(command, given.camera.value, rows, Tolerance().error)
    file = given.out / "wrong-input.md"
    _, mark, others = (file.read_text() if file.exists() else "").partition("\n## ")
    file.write_text(page + mark + others)


if __name__ == "__main__":
    main()
