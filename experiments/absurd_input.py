"""What pretouch answers to absurd input, and how far off the object would be.

    python -m experiments.absurd_input [--meshes DIR] [--limit 20] [--seed 0] [--camera random] [--out docs/results]

Writes the section "Absurd input" of wrong-input.md, whose first part `experiments.wrong_input` writes.
"""

from __future__ import annotations

import argparse
import asyncio
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pretouch_orchestrator.perception.preparation import prepare_scene
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.sessions.transitions import inspect_submission
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.finger import FingerModel, realise
from pretouch_simulation.in_process import InProcessDetector, InProcessRegistrar
from pretouch_simulation.markdown import markdown_table
from pretouch_simulation.mesh import load_mesh
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.protocol import Case, generator, make_case
from pretouch_simulation.scanning import scan_along
from pretouch_simulation.split import Split
from rich.progress import track

from experiments.command_line import command_of
from experiments.folders import RESULTS, SHARED
from experiments.wrong_input import make_glass
from pretouch.camera import Camera, DepthImage
from pretouch.errors import PretouchError, wire_of
from pretouch.geometry import Array, Pose, rotation_from_quaternion
from pretouch.session import Points, Proposer, SessionRequest
from pretouch.session_warning import SessionWarning
from pretouch.tof import RangeSamples

HEADING = "## Absurd input"
UNIT = 0.0001
"""m of a stored unit of the images that are sent."""
FAR = 3.0
"""m: depth of what is seen behind the table."""


class Sent(NamedTuple):
    """What a client sends to create a session."""

    request: SessionRequest
    values: NDArray[Any]
    mask: NDArray[np.bool_]

    def posed(self, change: Callable[[Pose], Pose]) -> Sent:
        return self._replace(request=replace(self.request, base_T_camera=change(self.request.base_T_camera)))

    def scaled(self, scale: float | None, unit: float, dtype: type = np.uint16) -> Sent:
        """With an image in units of `unit`, m, that is said to be in `scale`."""
        metres = self.values * UNIT / unit
        values: NDArray[np.generic] = (np.round(metres) if dtype is np.uint16 else metres).astype(dtype)
        return self._replace(request=replace(self.request, depth_scale=scale), values=values)

    def seen_by(self, change: Callable[[Camera], Camera]) -> Sent:
        return self._replace(request=replace(self.request, camera=change(self.request.camera)))

    def changed_in_mask(self, pixel: int, depth: float) -> Sent:
        """With one pixel of the mask at another depth, m."""
        values = self.values.copy()
        v, u = np.nonzero(self.mask)
        values[v[pixel], u[pixel]] = round(depth / UNIT)
        return self._replace(values=values)

    def bled(self) -> Sent:
        """With three pixels of what is behind the table in the mask."""
        values, mask = self.values.copy(), self.mask.copy()
        v, u = np.nonzero(self.mask)
        window = np.s_[max(0, v[0] - 6), u[0] - 1 : u[0] + 2]
        values[window], mask[window] = round(FAR / UNIT), True
        return self._replace(values=values, mask=mask)

    def cloud(self, truth: NDArray[np.bool_]) -> Array:
        """(n, 3), m, in base: the object's points, `truth` (h, w), as what is sent says."""
        depth = DepthImage.from_values(self.values, self.request.depth_scale)
        return self.request.base_T_camera.apply(self.request.camera.back_project_image(depth.metres)[truth])


def turned(rotation: Any) -> Callable[[Pose], Pose]:
    return lambda pose: pose @ Pose.of(rotation, np.zeros(3))


def _reorder(pose: Pose) -> Pose:
    return Pose.from_quaternion(pose.translation, np.roll(pose.quaternion, 1))


VIEWS: dict[str, Callable[[Sent], Sent]] = {
    "nothing": lambda sent: sent,
    "`base_T_camera` inverted": lambda sent: sent.posed(Pose.inverse),
    "`base_T_camera` in w, x, y, z": lambda sent: sent.posed(_reorder),
    "`base_T_camera` in mm": lambda sent: sent.posed(lambda pose: Pose.of(pose.rotation, 1000 * pose.translation)),
    "`base_T_camera` of the link frame": lambda sent: sent.posed(turned([[0, -1, 0], [0, 0, -1], [1, 0, 0]])),
    "`base_T_camera` with OpenGL axes": lambda sent: sent.posed(turned(np.diag([1.0, -1.0, -1.0]))),
    "`base_T_camera` the identity": lambda sent: sent.posed(lambda _: Pose.identity()),
    "metres said to be mm": lambda sent: sent.scaled(0.001, 1.0, np.float32),
    "mm as floats, no `depth_scale`": lambda sent: sent.scaled(None, 0.001, np.float32),
    "0.1 mm, no `depth_scale`": lambda sent: sent.scaled(None, UNIT),
    "1/5000 m, no `depth_scale`": lambda sent: sent.scaled(None, 1 / 5000),
    "bytes swapped": lambda sent: sent._replace(values=sent.values.byteswap()),
    "intrinsics of twice the size": lambda sent: sent.seen_by(
        lambda c: Camera(2 * c.fx, 2 * c.fy, 2 * c.cx + 0.5, 2 * c.cy + 0.5)
    ),
    "intrinsics of half the size": lambda sent: sent.seen_by(
        lambda c: Camera(c.fx / 2, c.fy / 2, c.cx / 2 - 0.25, c.cy / 2 - 0.25)
    ),
    "`cx` and `cy` swapped": lambda sent: sent.seen_by(lambda c: Camera(c.fx, c.fy, c.cy, c.cx)),
    "mask inverted": lambda sent: sent._replace(mask=~sent.mask),
    "mask 100 px off": lambda sent: sent._replace(mask=np.roll(sent.mask, 100, axis=1)),
    "one pixel of the mask 65535": lambda sent: sent.changed_in_mask(sent.mask.sum() // 2, 65535 * UNIT),
    "one pixel of the mask at 3 m": lambda sent: sent.changed_in_mask(sent.mask.sum() // 2, FAR),
    "three pixels behind the table in the mask": Sent.bled,
}
"""Mistakes in what creates a session."""


def _move(samples: RangeSamples, change: Callable[[Pose], Pose]) -> RangeSamples:
    poses = [change(Pose(matrix)).matrix for matrix in samples.base_T_tip]
    return replace(samples, base_T_tip=np.stack(poses))


def _reorder_tip(pose: Pose) -> Pose:
    return Pose.of(rotation_from_quaternion(np.roll(pose.quaternion, 1)), pose.translation)


SCANS: dict[str, Callable[[RangeSamples, Record], RangeSamples | Points]] = {
    "a scan: nothing": lambda samples, _: samples,
    "ranges in mm": lambda samples, _: replace(samples, range=1000 * samples.range),
    "tip poses in mm": lambda samples, _: _move(samples, lambda pose: Pose.of(pose.rotation, 1000 * pose.translation)),
    "tip poses in w, x, y, z": lambda samples, _: _move(samples, _reorder_tip),
    "tip poses with z backwards": lambda samples, _: _move(samples, turned(np.diag([1.0, -1.0, -1.0]))),
    "tip poses of a flange 15 cm higher": lambda samples, _: _move(
        samples, lambda pose: pose @ Pose.of(np.eye(3), [0.0, 0.0, -0.15])
    ),
    "`t` in ms": lambda samples, _: replace(samples, t=1000 * samples.t),
    "points in mm": lambda samples, record: Points(1000 * samples.beams(record.request.sensor).points()),
}
"""Mistakes in a session's first scan."""


def answer(inspect: Callable[[], Sequence[SessionWarning]]) -> str:
    """The warnings' codes, the status of a refusal, or nothing."""
    try:
        return ", ".join(f"`{warning.code}`" for warning in inspect()) or "nothing said"
    except PretouchError as refusal:
        return str(wire_of(refusal).http_status)


def sent_of(case: Case) -> Sent:
    request = SessionRequest(case.camera, case.base_T_camera, depth_scale=UNIT, proposer=Proposer.RANDOM)
    return Sent(request, np.round(case.depth.metres / UNIT).astype(np.uint16), case.mask)


def inspect_view(sent: Sent) -> Sequence[SessionWarning]:
    """The warnings of a session at its creation; raises InvalidInput where it is refused."""
    return prepare_scene(sent.request, DepthImage.from_values(sent.values, sent.request.depth_scale), sent.mask)[2]


def scan_first(case: Case, loop: Loop) -> tuple[Record, RangeSamples] | None:
    """A session that waits for its first scan, and what an ideal finger measures of it."""
    sent = sent_of(case)
    depth = DepthImage.from_values(sent.values, UNIT)
    record = asyncio.run(loop.open("absurd", 0.0, sent.request, depth, sent.mask))
    if record.next_scan is None:
        return None
    finger = realise(FingerModel.IDEAL, generator("finger", case.name))
    rng = generator("absurd", case.name)
    return record, scan_along(case.world, record.next_scan.path, record.request.sensor, finger, rng)


def text(command: str, camera: str, n: int, rows: dict[str, tuple[list[str], list[float]]]) -> str:
    """The section."""
    table = []
    for name, (said, off) in rows.items():
        count = ", ".join(f"{what} {number}" for what, number in Counter(said).most_common())
        where = f"{np.median(off):.2f} (up to {max(off):.2f})" if off and max(off) > 1e-3 else "-"
        table.append([name, where, count])
    return "\n".join(
        [
            HEADING,
            f"\nMade by `{command}`: {n} meshes of the validation side, one view each by camera `{camera}`, depth "
            "stored in 0.1 mm. *Object off*: how far from where they belong what is sent puts the object's points, "
            "median over the views (largest); before these checks sessions went on with it, or ended with an error "
            "about something else. *Answer*: a status is that of a refusal, a code that of a warning in the session.\n",
            markdown_table(("what is wrong", "object off, m", "answer, and how often"), table),
            "",
        ]
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--meshes", type=Path, default=SHARED / "data" / "meshes" / "train")
    parser.add_argument("--limit", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--camera", type=CameraModel, choices=list(CameraModel), default=CameraModel.RANDOM)
    parser.add_argument("--out", type=Path, default=RESULTS)
    given = parser.parse_args(arguments)
    paths = meshes_in(given.meshes, limit=given.limit, split=Split.VALIDATION)
    loop = Loop(InProcessDetector(), InProcessRegistrar(Engine.POSTERIOR, Registrar()))
    glass = "table seen through all of the object"
    rows: dict[str, tuple[list[str], list[float]]] = {name: ([], []) for name in [*VIEWS, glass, *SCANS]}
    for path in track(paths, "Views"):
        case = make_case(path.stem, load_mesh(path), 0, given.seed, given.camera)
        right = sent_of(case)
        for name, spoil in VIEWS.items():
            sent = spoil(right)
            rows[name][0].append(answer(partial(inspect_view, sent)))
            off = np.linalg.norm(sent.cloud(case.scored) - right.cloud(case.scored), axis=1)
            rows[name][1].append(float(np.median(off)))
        rows[glass][0].append(answer(partial(inspect_view, sent_of(make_glass(1.0)(case)))))
        if (first := scan_first(case, loop)) is not None:
            record, samples = first
            for name, distort in SCANS.items():
                rows[name][0].append(answer(partial(_inspect_scan, record, distort(samples, record))))
    section = text(command_of("absurd_input", arguments), given.camera.value, len(paths), rows)
    page = given.out / "wrong-input.md"
    before = page.read_text().partition(HEADING)[0].rstrip() if page.exists() else ""
    page.write_text(f"{before}\n\n{section}".lstrip())


def _inspect_scan(record: Record, submission: RangeSamples | Points) -> Sequence[SessionWarning]:
    assert record.next_scan is not None
    return inspect_submission(record, record.next_scan, submission)


if __name__ == "__main__":
    main()
