"""What the registrar predicts of pieces of paths, against what scans of them then bring.

    python -m experiments.pieces [--meshes DIR] [--views 25] [--camera window] [--sensor ideal] [--out docs/results]

On each view of a training mesh, before and after a first scan, random pieces of perimeters are predicted and scanned,
some from so high that few samples or none return. Writes pieces.json and pieces.md: predicted and actual returns, and
the predicted error beside the stated and the true one after the scan, by the share that returned.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from pretouch_detector.proposals import propose
from pretouch_orchestrator.planning.path import plan_paths
from pretouch_registrar.registration import Registrar, Settings
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.finger import Finger, FingerModel, realise
from pretouch_simulation.labels.view import LabelView, view_of
from pretouch_simulation.markdown import markdown_table
from pretouch_simulation.mesh import load_mesh
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.protocol import draw_hidden_offset, generator, make_case
from pretouch_simulation.split import Split
from rich.console import Console
from rich.progress import track

from experiments.command_line import command_of, run_or_exit
from experiments.folders import RESULTS, SHARED
from pretouch.estimate import Estimate
from pretouch.scan_prediction import Candidate
from pretouch.session import Proposer, ScanSettings
from pretouch.tof import Scan
from pretouch.trajectory import Trajectory

LIFTS = (0.0, 0.0, 0.02, 0.04, 0.06)
"""m by which a path is raised, equally probable."""
SHARES = (0.2, 0.4, 1.0)
"""Lengths of pieces over that of their path, equally probable."""
PIECES = 2
"""Pieces of each view, before and after its first scan."""
RETURNS = (0.1, 0.5, 0.9)
"""Bounds of the shares of returns by which pieces are grouped."""


@dataclass(frozen=True)
class Piece:
    """One piece: shares of returns, and errors in metres.

    Attributes:
        stage: scans made before.
        present: the error that the estimate states before the scan.
        predicted, stated, true: predicted after it; stated by the estimate from it; true then.
    """

    mesh: str
    stage: int
    predicted_returns: float
    returns: float
    present: float
    predicted: float
    stated: float
    true: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", type=Path, default=SHARED / "data" / "meshes" / "train")
    parser.add_argument("--views", type=int, default=25)
    parser.add_argument("--camera", type=CameraModel, choices=list(CameraModel), default=CameraModel.WINDOW)
    parser.add_argument("--sensor", type=FingerModel, choices=list(FingerModel), default=FingerModel.IDEAL)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=RESULTS)
    run_or_exit(parser.parse_args(), run)


def run(arguments: argparse.Namespace) -> None:
    """Writes pieces.json and pieces.md into the folder `arguments.out`."""
    paths = meshes_in(arguments.meshes, split=Split.TRAIN)[: arguments.views]
    pieces = list[Piece]()
    for path in track(paths, "views", console=Console(stderr=True)):
        seed = arguments.seed
        view = view_of(make_case(path.stem, load_mesh(path), 0, seed, arguments.camera))
        finger = realise(arguments.sensor, generator("pieces finger", seed, path.stem))
        pieces += scan_pieces(view, finger, generator("pieces", seed, path.stem))
    arguments.out.mkdir(parents=True, exist_ok=True)
    content = {"command": command_of("pieces"), "seed": arguments.seed, "rows": [asdict(piece) for piece in pieces]}
    (arguments.out / "pieces.json").write_text(json.dumps(content) + "\n")
    table = format_table(pieces)
    (arguments.out / "pieces.md").write_text(
        f"Pieces of paths on training meshes, seed {arguments.seed}, camera {arguments.camera.value}, finger "
        f"{arguments.sensor.value}, by `{command_of('pieces')}`. Means; errors in cm.\n\n{table}"
    )
    print(table)


def scan_pieces(view: LabelView, finger: Finger, rng: np.random.Generator) -> Iterable[Piece]:
    """PIECES of the view before its first scan, and as many after it."""
    scene, registrar, settings = view.scene, Registrar(), Settings(sensor=finger.sensor)
    truth = draw_hidden_offset(view.case.cloud, rng)
    proposals = propose(scene, Proposer.RANDOM, finger.sensor, 20, 1).regions
    scans, estimate = list[Scan](), registrar.register(scene, [], settings)
    for stage in (0, 1):
        planned = plan_paths(scene, [each.rectangle for each in proposals], estimate, ScanSettings())
        paths = [path for path in planned if path is not None]
        if not paths:
            return
        for _ in range(PIECES):
            piece = draw_piece(paths, rng)
            ((prediction,),) = registrar.predict(scene, scans, settings, [Candidate(piece)])
            scan = view.scan(truth, piece, finger, rng)
            after = registrar.register(scene, [*scans, scan], settings)
            yield Piece(
                view.case.name,
                stage,
                prediction.expected_returns,
                float(scan.returned.mean()),
                estimate.expected_error,
                prediction.expected_error,
                after.expected_error,
                _true_error(view, after, truth.apply(view.case.cloud)),
            )
        scans.append(view.scan(truth, paths[0], finger, rng))
        estimate = registrar.register(scene, scans, settings)


def draw_piece(paths: Sequence[Trajectory], rng: np.random.Generator) -> Trajectory:
    """A random piece of one of the paths, raised against the beam."""
    path = paths[int(rng.integers(len(paths)))]
    raised = path.base_T_tip.copy()
    raised[:, :3, 3] -= rng.choice(LIFTS) * raised[:, :3, 2]
    share = rng.choice(SHARES)
    start = path.t[0] + rng.uniform(0, 1 - share) * path.duration
    end = min(start + share * path.duration, path.t[-1])
    return Trajectory(path.t, raised).between(float(start), float(end))


def _true_error(view: LabelView, estimate: Estimate, true_cloud: np.ndarray) -> float:
    return float(np.linalg.norm(true_cloud - estimate.base_T_correction.apply(view.case.cloud), axis=1).mean())


def format_table(pieces: Sequence[Piece]) -> str:
    """A line for each stage and group of pieces by the share of their samples that returned."""
    headings = (
        *("scans before", "returned", "n", "returned, mean", "predicted", "error before, stated"),
        *("predicted", "stated after", "true after"),
    )
    lines = []
    for stage in (0, 1):
        groups = np.digitize([piece.returns for piece in pieces], RETURNS)
        for group in range(len(RETURNS) + 1):
            chosen = [piece for piece, own in zip(pieces, groups, strict=True) if own == group and piece.stage == stage]
            if chosen:
                lines.append(_cells(stage, group, chosen))
    return markdown_table(headings, lines)


def _cells(stage: int, group: int, chosen: Sequence[Piece]) -> tuple[str, ...]:
    bounds = (0.0, *RETURNS, 1.0)
    shares = [np.mean([getattr(piece, name) for piece in chosen]) for name in ("returns", "predicted_returns")]
    names = ("present", "predicted", "stated", "true")
    errors = [100 * np.mean([getattr(piece, name) for piece in chosen]) for name in names]
    return (
        str(stage),
        f"{bounds[group]:.0%} to {bounds[group + 1]:.0%}",
        str(len(chosen)),
        *(f"{share:.0%}" for share in shares),
        *(f"{error:.2f}" for error in errors),
    )


if __name__ == "__main__":
    main()
