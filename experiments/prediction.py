"""How well the registrar predicts what a scan is worth: its predictions against what the scans then achieve.

    python -m experiments.prediction [--meshes DIR] [--scenes 12] [--offsets 16] [--out docs/results]

Each scene is one view of a mesh with a dozen random rectangles. After zero, one and two scans that are the same
rectangles in every session, each remaining candidate's error is predicted by `predict`, then scanned in the true world
and registered. Both numbers are averaged over hidden offsets; candidates are ranked within a scene. DIR is
data/meshes/train of PRETOUCH_SHARED unless given.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pretouch_orchestrator.planning.path import plan_paths
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar, Settings
from pretouch_simulation.fingers.ideal import ThinBeam
from pretouch_simulation.in_process import InProcessDetector, InProcessRegistrar
from pretouch_simulation.labels.view import LabelView
from pretouch_simulation.markdown import markdown_table
from pretouch_simulation.mesh import load_mesh
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.protocol import Case, draw_hidden_offset, generator, make_case
from pretouch_simulation.split import Split
from rich.console import Console
from rich.progress import track
from scipy.stats import spearmanr

from experiments.command_line import command_of, run_or_exit
from experiments.folders import RESULTS, SHARED
from pretouch.estimate import Estimate
from pretouch.geometry import Pose
from pretouch.rectangle import RotatedRectangle
from pretouch.scan_prediction import Candidate
from pretouch.scene import Scene
from pretouch.session import Planner, Proposer, ScanSettings, SessionRequest
from pretouch.tof import Scan
from pretouch.trajectory import Trajectory

STAGES = (0, 1, 2)
"""Scans made before the candidates are compared."""
TIMED = 20
"""Candidates in a call that is timed."""
BEST = 3


@dataclass(frozen=True, eq=False)
class View:
    """One view of an object: what a session knows of it, and the case that it came from.

    Attributes:
        made: the rectangles of the scans that come first, in order.
        candidates: those that are compared.
    """

    seen: LabelView
    made: tuple[RotatedRectangle, ...]
    candidates: tuple[RotatedRectangle, ...]

    @property
    def case(self) -> Case:
        return self.seen.case

    @property
    def scene(self) -> Scene:
        return self.seen.scene


@dataclass(frozen=True)
class Comparison:
    """One view after some scans: per candidate (c,) and hidden offset (o,), m.

    Attributes:
        present: (o,) the error before the candidate's scan.
        predicted, achieved: (c, o) the predicted error, and the error once the candidate is scanned.
        milliseconds: per call of `predict` with TIMED candidates, (o,).
    """

    mesh: str
    stage: int
    present: list[float]
    predicted: list[list[float]]
    achieved: list[list[float]]
    milliseconds: list[float]

    @property
    def rank_correlation(self) -> float:
        """Spearman's, of the means over the offsets."""
        return float(spearmanr(np.mean(self.predicted, axis=1), np.mean(self.achieved, axis=1))[0])

    @property
    def reliability(self) -> float:
        """Spearman's correlation of the achieved means of one half of the offsets with those of the other half."""
        achieved = np.array(self.achieved)
        return float(spearmanr(achieved[:, ::2].mean(axis=1), achieved[:, 1::2].mean(axis=1))[0])

    def best(self, by: str) -> float:
        """m: mean error achieved by the BEST candidates `by` "predicted", "achieved", or "chance"."""
        achieved = np.mean(self.achieved, axis=1)
        if by == "chance":
            return float(achieved.mean())
        return float(achieved[np.argsort(np.mean(getattr(self, by), axis=1), kind="stable")[:BEST]].mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", type=Path, default=SHARED / "data" / "meshes" / "train")
    parser.add_argument("--split", type=Split, choices=list(Split), default=Split.VALIDATION)
    parser.add_argument("--scenes", type=int, default=12)
    parser.add_argument("--offsets", type=int, default=16)
    parser.add_argument("--candidates", type=int, default=12)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=RESULTS)
    run_or_exit(parser.parse_args(), run)


def run(arguments: argparse.Namespace) -> None:
    """Writes prediction.json and prediction.md into the folder `arguments.out`."""
    comparisons: list[Comparison] = []
    views = views_of(arguments.meshes, arguments.split, arguments.candidates, arguments.seed)
    for _, view in zip(track(range(arguments.scenes), "scenes", console=Console(stderr=True)), views, strict=False):
        comparisons += [compare(view, stage, arguments.offsets, arguments.seed) for stage in STAGES]
    arguments.out.mkdir(parents=True, exist_ok=True)
    content = {
        "command": command_of("prediction"),
        "split": arguments.split.value,
        "seed": arguments.seed,
        "rows": [asdict(comparison) for comparison in comparisons],
    }
    (arguments.out / "prediction.json").write_text(json.dumps(content) + "\n")
    table = format_table(comparisons, arguments.split, arguments.seed)
    (arguments.out / "prediction.md").write_text(table)
    print(table)


def views_of(folder: Path, split: Split, candidates: int, seed: int) -> Iterable[View]:
    """Views of the split's meshes in an order fixed by their names, without those with too few candidates."""
    for path in meshes_in(folder, split=split):
        view = view_of(make_case(path.stem, load_mesh(path), 0, seed), candidates)
        if view is not None:
            yield view


def view_of(case: Case, candidates: int) -> View | None:
    """The view as a session sees it, with the first rectangles that have a path; None if there are too few."""
    request = SessionRequest(
        camera=case.camera,
        base_T_camera=case.base_T_camera,
        depth_scale=1.0,
        proposer=Proposer.RANDOM,
        planner=Planner.CONFIDENCE,
    )
    loop = Loop(InProcessDetector(), InProcessRegistrar(Engine.PAPER, Registrar()))
    record = asyncio.run(loop.open(case.name, 0.0, request, case.depth, case.mask))
    u0, v0 = record.origin
    rectangles = [region.rectangle.shifted(-u0, -v0) for region in record.regions]
    paths = plan_paths(record.scene, rectangles, record.estimate, ScanSettings())
    usable = [rectangle for rectangle, path in zip(rectangles, paths, strict=True) if path is not None]
    first = max(STAGES)
    if len(usable) < first + candidates:
        return None
    seen = LabelView(case, record.scene, record.origin)
    return View(seen, tuple(usable[:first]), tuple(usable[first : first + candidates]))


def compare(view: View, stage: int, offsets: int, seed: int) -> Comparison:
    """Predicts, scans and registers each candidate after `stage` scans, in a session for each hidden offset."""
    present, predicted, achieved, milliseconds = [], [], [], []
    for session in sessions(view, stage, offsets, seed):
        present.append(session.error(session.estimate))
        paths = session.paths()
        predicted.append(session.predict_errors(paths))
        milliseconds.append(_time_prediction(session, paths))
        achieved.append(session.scan_each(paths))
    by_candidate = np.transpose(predicted).tolist(), np.transpose(achieved).tolist()
    return Comparison(view.case.name, stage, present, *by_candidate, milliseconds)


def _time_prediction(session: Session, paths: Sequence[Trajectory]) -> float:
    """ms of a prediction for TIMED candidates, without the registration of the earlier scans."""
    many = [paths[k % len(paths)] for k in range(TIMED)]
    started = time.perf_counter()
    session.predict_errors(many)
    return 1000.0 * (time.perf_counter() - started)


@dataclass(frozen=True, eq=False)
class Session:
    """A session under one hidden offset: `truth` maps the object from where the camera puts it to where it is."""

    view: View
    truth: Pose
    scans: tuple[Scan, ...]
    estimate: Estimate
    names: tuple[object, ...]
    registrar: Registrar

    def error(self, estimate: Estimate) -> float:
        """m: mean distance of the object's points, as corrected, from their true place."""
        cloud = self.view.case.cloud
        moved = estimate.base_T_correction.apply(cloud)
        return float(np.linalg.norm(self.truth.apply(cloud) - moved, axis=1).mean())

    def paths(self) -> list[Trajectory]:
        """The candidates' paths from the present estimate."""
        planned = plan_paths(self.view.scene, self.view.candidates, self.estimate, ScanSettings())
        return [path for path in planned if path is not None]

    def predict_errors(self, paths: Sequence[Trajectory]) -> list[float]:
        """m: the error that the registrar predicts after a scan of each path."""
        candidates = [Candidate(path) for path in paths]
        predictions = self.registrar.predict(self.view.scene, self.scans, Settings(), candidates)
        return [whole.expected_error for (whole,) in predictions]

    def scan(self, path: Trajectory, *name: object) -> Session:
        """The session after a scan of `path`, whose noise is seeded by the session's names and `name`."""
        names = (*self.names, *name)
        scan = self.view.seen.scan(self.truth, path, ThinBeam(), generator(*names))
        scans = (*self.scans, scan)
        estimate = self.registrar.register(self.view.scene, scans, Settings())
        return replace(self, scans=scans, estimate=estimate, names=names)

    def scan_each(self, paths: Sequence[Trajectory]) -> list[float]:
        """m: the error after a scan of each path, each as the next one."""
        after = [self.scan(path, "candidate", k) for k, path in enumerate(paths)]
        return [session.error(session.estimate) for session in after]


def sessions(view: View, stage: int, offsets: int, seed: int) -> Iterable[Session]:
    """A session for each of `offsets` hidden offsets, with the view's first `stage` scans made."""
    registrar = Registrar()
    for k in range(offsets):
        names = ("prediction", seed, view.case.name, k)
        truth = draw_hidden_offset(view.case.cloud, generator(*names))
        session = Session(view, truth, (), registrar.register(view.scene, (), Settings()), names, registrar)
        for rectangle in view.made[:stage]:
            path = plan_paths(view.scene, [rectangle], session.estimate, ScanSettings())[0]
            if path is not None:
                session = session.scan(path, "made")
        yield session


def format_table(comparisons: Sequence[Comparison], split: Split, seed: int) -> str:
    """A line for each number of scans made before; errors in centimetres."""
    sizes = np.shape(comparisons[0].achieved)
    note = (
        f"Predicted against achieved errors within a scene: {split} meshes, seed {seed}, {sizes[0]} random rectangles "
        f"a scene, both averaged over {sizes[1]} hidden offsets; ideal finger. Errors in cm. Between halves: how "
        "well the achieved errors of every other offset rank as those of the rest, which limits any prediction."
    )
    headings = (
        *("scans before", "scenes", "Spearman, mean (std)", "between halves", "present error", "three best predicted"),
        *("three best achieved", "ratio", "any", "mean predicted / achieved", f"ms for {TIMED} candidates"),
    )
    lines = [_cells(stage, [c for c in comparisons if c.stage == stage]) for stage in STAGES]
    return f"{note}\n\n{markdown_table(headings, lines)}"


def _cells(stage: int, chosen: Sequence[Comparison]) -> tuple[str, ...]:
    correlations = np.array([c.rank_correlation for c in chosen])
    predicted, oracle, chance = (
        100 * float(np.mean([c.best(by) for c in chosen])) for by in ("predicted", "achieved", "chance")
    )
    mean_predicted = 100 * _mean([np.mean(c.predicted) for c in chosen])
    return (
        str(stage),
        str(len(chosen)),
        f"{correlations.mean():.2f} ({correlations.std():.2f})",
        f"{_mean([c.reliability for c in chosen]):.2f}",
        f"{100 * _mean([np.mean(c.present) for c in chosen]):.2f}",
        f"{predicted:.2f}",
        f"{oracle:.2f}",
        f"{predicted / oracle:.2f}",
        f"{chance:.2f}",
        f"{mean_predicted:.2f} / {chance:.2f}",
        f"{np.median([ms for c in chosen for ms in c.milliseconds]):.0f}",
    )


def _mean(values: Sequence[Any]) -> float:
    return float(np.mean(values))


if __name__ == "__main__":
    main()
