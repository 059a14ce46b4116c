"""How much a perfect choice among many pieces of paths is worth, against pieces of a few regions, judged by PredictScans and by scans.

    python -m experiments.screening [--meshes DIR] [--scenes 12] [--offsets 8] [--out OUT.json]
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from pretouch_detector.proposals import information as analytic
from pretouch_detector.proposals.displaced import average_square_errors
from pretouch_detector.proposals.random import draw_candidates
from pretouch_detector.proposals.relief import map_relief
from pretouch_orchestrator.planning.path import plan_paths
from pretouch_orchestrator.planning.tip_floor import SAFE, Margins
from pretouch_registrar import prediction
from pretouch_registrar.downsampling import downsample_scene
from pretouch_registrar.engines.solution import pose_from_correction
from pretouch_registrar.registration import Registrar, Settings, _select_scans
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.fingers.ideal import ThinBeam
from pretouch_simulation.labels.view import LabelView, view_of
from pretouch_simulation.mesh import load_mesh
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.protocol import draw_hidden_offset, generator, make_case
from pretouch_simulation.split import Split
from scipy.stats import spearmanr

from experiments.folders import SHARED
from experiments.piece_predictor import BeamModel, draw_normal
from pretouch.errors import PretouchError
from pretouch.estimate import Estimate, from_prior, point_error
from pretouch.geometry import Array, Pose
from pretouch.rectangle import RotatedRectangle
from pretouch.session import ScanSettings
from pretouch.tof import Scan
from pretouch.trajectory import Trajectory

APPROACH = 1.5
LENGTHS = (0.04, 0.07, 0.12, 0.20)

REGIONS, RANDOM, LINES, FEW, SHORT = 20, 350, 150, 60, 12
SCANNED = ("regions", "all", "500", "few", "screen10", "whole")
SECOND_OFFSETS = 4
CAMERAS = (CameraModel.KINECT, CameraModel.WINDOW, CameraModel.RANDOM)


@dataclass(frozen=True, eq=False)
class Piece:
    whole: Trajectory
    start: float
    end: float
    kind: str  # region, random, line

    @cached_property
    def path(self) -> Trajectory:
        return cut(self.whole, self.start, self.end)

    @property
    def seconds(self) -> float:
        return self.end - self.start + APPROACH


def cut(path: Trajectory, start: float, end: float) -> Trajectory:
    """The part from start to end, s."""
    inner = path.t[(path.t > start + 1e-6) & (path.t < end - 1e-6)]
    end = min(end, path.t[-1])
    times = np.concatenate([[start], inner, [end]])
    return Trajectory(times - start, path.at(times))


def windows(path: Trajectory, speed: float, lengths: Sequence[float] = LENGTHS) -> list[tuple[float, float]]:
    found = [(0.0, path.duration)]
    for length in lengths:
        duration = length / speed
        if duration > 0.9 * path.duration:
            continue
        step = max(length / 2, 0.03) / speed
        count = int(np.ceil((path.duration - duration) / step)) + 1
        found += [(s, s + duration) for s in np.linspace(0, path.duration - duration, count)]
    return found


def random_window(path: Trajectory, speed: float, rng: np.random.Generator, most: float) -> tuple[float, float]:
    duration = min(np.exp(rng.uniform(np.log(0.03), np.log(0.20))) / speed, most)
    start = rng.uniform(0, most - duration)
    return start, min(start + duration, float(path.t[-1]))


def draw_lines(view: LabelView, count: int, rng: np.random.Generator) -> list[RotatedRectangle]:
    """Flat rectangles: there and back along a line."""
    u0, v0, u1, v1 = view.scene.bounds()
    size = np.hypot(u1 - u0, v1 - v0)
    return [
        RotatedRectangle(rng.uniform(u0, u1), rng.uniform(v0, v1), rng.uniform(0.3, 1.2) * size, 0.5, rng.uniform(-np.pi / 2, np.pi / 2))
        for _ in range(count)
    ]


def make_pool(view: LabelView, estimate: Estimate, regions: Sequence[RotatedRectangle], rng: np.random.Generator, margins: Margins) -> list[Piece]:
    settings = ScanSettings()
    rectangles = [*regions, *draw_candidates(view.scene, RANDOM, rng), *draw_lines(view, LINES, rng)]
    n, m = len(regions), len(rectangles) - LINES
    paths = plan_paths(view.scene, rectangles, estimate, settings, margins)
    pool: list[Piece] = []
    for k, path in enumerate(paths):
        if path is None or path.duration < 0.5:
            continue
        if k < n:
            pool += [Piece(path, *span, "region") for span in windows(path, settings.speed)]
        elif k < m:
            pool.append(Piece(path, *random_window(path, settings.speed, rng, path.duration), "random"))
        else:
            pool.append(Piece(path, *random_window(path, settings.speed, rng, path.duration / 2), "line"))
    return pool


class Predictor:
    """PredictScans with draws of one's own."""

    def __init__(self, registrar: Registrar, view: LabelView, scans: Sequence[Scan], settings: Settings) -> None:
        self.scene = downsample_scene(view.scene)
        ordered = _select_scans(self.scene, scans, settings)
        self.problem, self.solution = registrar._solve_cached(self.scene, ordered, settings)
        self.cloud = pose_from_correction(self.solution.x, self.scene.centroid).apply(self.scene.cloud)
        self.centre = self.scene.centroid + self.solution.x[3:]
        self.sensor = settings.sensor

    def present(self) -> float:
        return point_error(self.solution.covariance, self.cloud, self.centre)[0]

    def covariance(self, piece: Piece) -> Array:
        return prediction.predict_covariance(self.problem, self.solution.x, self.solution.covariance, piece.path, self.sensor)

    def error(self, covariance: Array) -> float:
        return point_error(covariance, self.cloud, self.centre)[0]

    def errors(self, pieces: Sequence[Piece]) -> Array:
        return np.array([self.error(self.covariance(p)) for p in pieces])

    def fast_errors(self, pieces: Sequence[Piece], truths: int, rng: np.random.Generator) -> Array:
        """By the beams' quadratics, at the scale of what a typical piece leaves."""
        few = rng.choice(len(pieces), 6, replace=False)
        typical = np.mean([self.covariance(pieces[i]) for i in few], axis=0)
        problem, x, c = self.problem, self.solution.x, self.solution.covariance
        whole: dict[int, int] = {}
        paths: list[Trajectory] = []
        spans = []
        for piece in pieces:
            if piece.kind == "region":
                if id(piece.whole) not in whole:
                    whole[id(piece.whole)] = len(paths)
                    paths.append(piece.whole)
                spans.append((whole[id(piece.whole)], piece.start, piece.end))
            else:
                spans.append((len(paths), 0.0, piece.path.duration))
                paths.append(piece.path)
        model = BeamModel(problem, x, c, paths, self.sensor, np.linalg.cholesky(typical), truths, 21)
        return np.array([self.error(model.covariance(*span)) for span in spans])

    def with_draws(self, pieces: Sequence[Piece], seeds: Sequence[int]) -> Array:
        """The mean over other draws of PredictScans."""
        own = prediction._draw_normal
        try:
            total = np.zeros(len(pieces))
            for seed in seeds:
                draws = draw_normal(16, seed)
                prediction._draw_normal = lambda count, draws=draws: draws
                total += self.errors(pieces)
            return total / len(seeds)
        finally:
            prediction._draw_normal = own


def screen_analytically(view: LabelView, estimate: Estimate, covariance: Array, pieces: Sequence[Piece], settings: Settings) -> Array:
    """Log reduction of the root mean square error by the linearised information."""
    seen = map_relief(view.scene)
    rows = analytic._linearise_beams(seen, settings.sensor)
    table_T_base = view.scene.table.frame().inverse()
    centre = table_T_base.apply(view.scene.centroid)
    back = (table_T_base @ estimate.base_T_correction.inverse()).matrix
    ways, lengths = [], []
    for piece in pieces:
        tips = piece.path.at(np.linspace(piece.path.t[0], piece.path.t[-1], 30))[:, :3, 3]
        ways.append((tips @ back[:3, :3].T + back[:3, 3] - centre)[:, :2])
        lengths.append(piece.path.length)
    independent = 12.0 * (np.array(lengths) / 0.2) ** 0.3 / 30
    turn = np.kron(np.eye(2), table_T_base.rotation)
    c = turn @ covariance @ turn.T
    marginal = c[np.ix_([3, 4, 2], [3, 4, 2])]
    shifts = draw_normal(16, 5)[:, :3] @ np.linalg.cholesky(marginal).T
    lever = analytic._compute_lever(seen.spread)
    squares = average_square_errors(rows, seen.grid, np.ascontiguousarray(ways), independent, np.ascontiguousarray(shifts), np.linalg.inv(c), lever)
    return 0.5 * np.log(np.trace(lever.T @ c @ lever) / squares)


def shortlist(pool: Sequence[Piece], rate: Array, guess: Array, rng: np.random.Generator) -> dict[str, Array]:
    """By strategy: the indices of the pieces among which PredictScans decides."""
    kinds = np.array([p.kind for p in pool])
    everything, region, five = np.arange(len(pool)), np.flatnonzero(kinds == "region"), np.flatnonzero(kinds != "region")

    def top(among: Array, by: Array, count: int = SHORT) -> Array:
        return among[np.argsort(-by[among])[:count]]

    return {
        "regions": top(region, rate),
        "all": top(everything, rate),
        "500": top(five, rate),
        "lines": top(np.flatnonzero(kinds == "line"), rate),
        "perimeters": top(np.flatnonzero(kinds == "random"), rate),
        "few": top(rng.choice(five, min(FEW, len(five)), replace=False), rate),
        "screen10": top(five, guess, 10),
        "screen10all": top(everything, guess, 10),
        "whole": top(np.array([i for i in region if pool[i].start == 0 and pool[i].end == pool[i].whole.duration]), rate),
    }


def error_of(view: LabelView, truth: Pose, estimate: Estimate) -> float:
    cloud = view.case.cloud
    return float(np.linalg.norm(truth.apply(cloud) - estimate.base_T_correction.apply(cloud), axis=1).mean())


def evaluate_state(view, registrar, settings, scans, estimate, regions, names, margins):
    """The pool's choices by each strategy in one state of a session."""
    rng = generator("screening", *names)
    clock = [time.perf_counter()]
    pool = make_pool(view, estimate, regions, rng, margins)
    clock.append(time.perf_counter())
    predictor = Predictor(registrar, view, scans, settings)
    present = predictor.present()
    fast = predictor.fast_errors(pool, 16, rng)
    clock.append(time.perf_counter())
    seconds = np.array([p.seconds for p in pool])
    rate = np.log(present / fast) / seconds
    guess = screen_analytically(view, estimate, predictor.solution.covariance, pool, settings) / seconds
    clock.append(time.perf_counter())
    lists = shortlist(pool, rate, guess, rng)
    needed = np.unique(np.concatenate(list(lists.values())))
    finer = dict(zip(needed.tolist(), predictor.with_draws([pool[i] for i in needed], (3, 4)), strict=True))
    chosen = {name: int(max(among.tolist(), key=lambda i: np.log(present / finer[i]) / seconds[i])) for name, among in lists.items()}
    distinct = sorted(set(chosen.values()))
    again = dict(zip(distinct, predictor.with_draws([pool[i] for i in distinct], (11, 12)), strict=True))
    clock.append(time.perf_counter())
    kinds = np.array([p.kind for p in pool])
    info = {
        "present": present, "pool": {kind: int((kinds == kind).sum()) for kind in ("region", "random", "line")},
        "clock": np.diff(clock).round(2).tolist(),
        "analytic_spearman": float(spearmanr(rate, guess)[0]),
        "fast_spearman": float(spearmanr(fast[needed], list(finer.values()))[0]),
        "fast_bias": float(np.mean(np.log(fast[needed] / list(finer.values())))),
        "rate_quantiles": np.quantile(rate, [0.05, 0.25, 0.5, 0.75, 0.95, 0.99, 1]).tolist(),
        "choices": {name: {"i": i, "kind": pool[i].kind, "seconds": pool[i].seconds, "length": pool[i].path.length, "predicted": float(finer[i]), "again": float(again[i])} for name, i in chosen.items()},
    }
    return pool, chosen, info


def run_scene(path: Path, index: int, offsets: int, seed: int, margins: Margins, out) -> None:
    case = make_case(path.stem, load_mesh(path), 0, seed, CAMERAS[index % len(CAMERAS)])
    view = view_of(case)
    registrar, settings, finger = Registrar(), Settings(), ThinBeam()
    prior = from_prior(settings.prior, view.scene.cloud)
    regions = draw_candidates(view.scene, REGIONS, generator("regions", seed, path.stem))
    pool, chosen, info = evaluate_state(view, registrar, settings, (), prior, regions, (seed, path.stem, 0), margins)
    initial, achieved, later = [], [], []
    for k in range(offsets):
        names = ("screening", seed, path.stem, k)
        truth = draw_hidden_offset(case.cloud, generator(*names))
        initial.append(error_of(view, truth, prior))
        results = {}
        for i in sorted({chosen[name] for name in SCANNED}):
            scan = view.scan(truth, pool[i].path, finger, generator(*names, "first", i))
            results[i] = (scan, registrar.register(view.scene, (scan,), settings))
        achieved.append({name: error_of(view, truth, results[chosen[name]][1]) for name in SCANNED})
        if k >= SECOND_OFFSETS:
            continue
        scan, estimate = results[chosen["regions"]]
        pool1, chosen1, info1 = evaluate_state(view, registrar, settings, (scan,), estimate, regions, (seed, path.stem, 1, k), margins)
        info1["before"], info1["achieved"] = [], []
        solution = registrar.solve(view.scene, (scan,), settings)
        draws = draw_normal(4, 77 + k)[[0, 1, 3]] @ np.linalg.cholesky(solution.covariance).T + solution.x
        for j, assumed in enumerate([truth, *(pose_from_correction(x, downsample_scene(view.scene).centroid) for x in draws)]):
            after = {}
            for i in sorted({chosen1[name] for name in SCANNED}):
                second = view.scan(assumed, pool1[i].path, finger, generator(*names, "second", i, j))
                after[i] = error_of(view, assumed, registrar.register(view.scene, (scan, second), settings))
            info1["before"].append(error_of(view, assumed, estimate))
            info1["achieved"].append({name: after[chosen1[name]] for name in SCANNED})
        later.append(info1)
    info["before"], info["achieved"] = initial, achieved
    out.write(json.dumps({"mesh": path.stem, "camera": CAMERAS[index % len(CAMERAS)].value, "first": info, "second": later}) + "\n")
    out.flush()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", type=Path, default=SHARED / "data" / "meshes" / "train")
    parser.add_argument("--split", type=Split, choices=list(Split), default=Split.TRAIN)
    parser.add_argument("--scenes", type=int, default=12)
    parser.add_argument("--offsets", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--low", action="store_true")
    parser.add_argument("--out", type=Path, required=True)
    a = parser.parse_args()
    margins = Margins(1.0, 1.0, 0.010) if a.low else SAFE
    with a.out.open("a") as out:
        for index, path in enumerate(meshes_in(a.meshes, split=a.split)[: a.scenes]):
            started = time.perf_counter()
            try:
                run_scene(path, index, a.offsets, a.seed, margins, out)
            except PretouchError as error:
                print(path.stem, error)
                continue
            print(path.stem, f"{time.perf_counter() - started:.0f} s", flush=True)


if __name__ == "__main__":
    main()
