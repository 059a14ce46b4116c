"""Sessions led by different choices of pieces, until converged: robot seconds, approach counted."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from pretouch_detector.proposals.random import draw_candidates
from pretouch_orchestrator.planning.path import plan_paths
from pretouch_orchestrator.planning.tip_floor import SAFE
from pretouch_registrar.registration import Registrar, Settings
from pretouch_simulation.fingers.ideal import ThinBeam
from pretouch_simulation.labels.view import view_of
from pretouch_simulation.mesh import load_mesh
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.protocol import draw_hidden_offset, generator, make_case
from pretouch_simulation.split import Split

from experiments import screening as S
from experiments.folders import SHARED
from pretouch.errors import PretouchError
from pretouch.estimate import MIN_FIT, from_prior
from pretouch.session import ScanSettings

TOLERANCE = 0.003
MOST = 8
SHORT = 6


def pool_of(name, view, estimate, regions, rng):
    settings = ScanSettings()
    if name in ("whole", "regions", "long"):
        paths = plan_paths(view.scene, regions, estimate, settings, SAFE)
        spans = (lambda p: [(0.0, p.duration)]) if name == "whole" else (lambda p: S.windows(p, settings.speed, (0.12, 0.20) if name == "long" else S.LENGTHS))
        return [S.Piece(p, *span, "region") for p in paths if p is not None and p.duration >= 0.5 for span in spans(p)]
    pool = S.make_pool(view, estimate, regions, rng, SAFE)
    if name == "few":
        five = [p for p in pool if p.kind != "region"]
        return [five[i] for i in rng.choice(len(five), min(60, len(five)), replace=False)]
    return pool


def run_session(view, truth, name, names):
    registrar, settings, finger = Registrar(), Settings(), ThinBeam()
    estimate = from_prior(settings.prior, view.scene.cloud)
    regions = draw_candidates(view.scene, S.REGIONS, generator("regions", 0, view.case.name))
    scans, steps, robot, scanning = [], [], 0.0, 0.0
    for k in range(MOST):
        rng = generator("screening", *names, name, k)
        pool = pool_of(name, view, estimate, regions, rng)
        started = time.perf_counter()
        predictor = S.Predictor(registrar, view, scans, settings)
        present = predictor.present()
        seconds = np.array([p.seconds for p in pool])
        fast = predictor.fast_errors(pool, 16 if not scans else 8, rng)
        best = np.argsort(-np.log(present / fast) / seconds)[:SHORT]
        finer = predictor.with_draws([pool[i] for i in best], (3,))
        i = int(best[np.argmax(np.log(present / finer) / seconds[best])])
        spent = time.perf_counter() - started
        scan = view.scan(truth, pool[i].path, finger, generator(*names, "scan", name, k))
        scans.append(scan)
        estimate = registrar.register(view.scene, scans, settings)
        robot += pool[i].seconds
        scanning += pool[i].path.duration
        error = S.error_of(view, truth, estimate)
        converged = estimate.error_quantile <= TOLERANCE and estimate.fit >= MIN_FIT
        steps.append({"robot": robot, "scanning": scanning, "error": error, "expected": estimate.expected_error, "quantile": estimate.error_quantile, "fit": estimate.fit, "converged": bool(converged), "kind": pool[i].kind, "pool": len(pool), "ms": 1000 * spent})
        if converged:
            break
    return steps


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--meshes", type=Path, default=SHARED / "data" / "meshes" / "train")
    parser.add_argument("--split", type=Split, choices=list(Split), default=Split.TRAIN)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--scenes", type=int, default=12)
    parser.add_argument("--offsets", type=int, default=1)
    parser.add_argument("--names", default="whole,regions,few,all")
    parser.add_argument("--out", type=Path, required=True)
    a = parser.parse_args()
    done = {tuple(json.loads(l)["key"]) for l in a.out.open()} if a.out.exists() else set()
    with a.out.open("a") as out:
        for k in range(a.offsets):
            for index, path in list(enumerate(meshes_in(a.meshes, split=a.split)))[a.first : a.first + a.scenes]:
                try:
                    case = make_case(path.stem, load_mesh(path), 0, 0, S.CAMERAS[index % len(S.CAMERAS)])
                    view = view_of(case)
                except PretouchError as error:
                    print(path.stem, error)
                    continue
                names = ("sessions", 0, path.stem, k)
                truth = draw_hidden_offset(case.cloud, generator(*names))
                for name in a.names.split(","):
                    key = (path.stem, k, name)
                    if key in done:
                        continue
                    started = time.perf_counter()
                    steps = run_session(view, truth, name, names)
                    out.write(json.dumps({"key": key, "camera": S.CAMERAS[index % len(S.CAMERAS)].value, "steps": steps}) + "\n")
                    out.flush()
                    print(*key, len(steps), f"{steps[-1]['robot']:.1f} s {1000 * steps[-1]['error']:.2f} mm", steps[-1]["converged"], f"{time.perf_counter() - started:.0f} s", flush=True)


if __name__ == "__main__":
    main()
