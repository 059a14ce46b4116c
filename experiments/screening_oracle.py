"""Whether what scans achieve tells more about pieces than PredictScans: the best by half of the offsets, judged by the others."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from pretouch_detector.proposals.random import draw_candidates
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
from pretouch.estimate import from_prior


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=12)
    parser.add_argument("--offsets", type=int, default=16)
    parser.add_argument("--out", type=Path, required=True)
    a = parser.parse_args()
    done = {json.loads(line)["mesh"] for line in a.out.open()} if a.out.exists() else set()
    registrar, settings, finger = Registrar(), Settings(), ThinBeam()
    for index, path in enumerate(meshes_in(SHARED / "data" / "meshes" / "train", split=Split.TRAIN)[: a.scenes]):
        if path.stem in done:
            continue
        try:
            case = make_case(path.stem, load_mesh(path), 0, 0, S.CAMERAS[index % len(S.CAMERAS)])
            view = view_of(case)
        except PretouchError as error:
            print(path.stem, error)
            continue
        started = time.perf_counter()
        rng = generator("oracle", path.stem)
        prior = from_prior(settings.prior, view.scene.cloud)
        regions = draw_candidates(view.scene, S.REGIONS, generator("regions", 0, path.stem))
        pool = S.make_pool(view, prior, regions, rng, SAFE)
        predictor = S.Predictor(registrar, view, (), settings)
        present = predictor.present()
        seconds = np.array([p.seconds for p in pool])
        rate = np.log(present / predictor.fast_errors(pool, 16, rng)) / seconds
        guess = S.screen_analytically(view, prior, predictor.solution.covariance, pool, settings) / seconds
        chosen = rng.choice(len(pool), 20, replace=False)
        best = [i for i in np.argsort(-rate) if i not in chosen][:12]
        chosen = np.concatenate([chosen, best])
        predicted = predictor.with_draws([pool[i] for i in chosen], (3, 4))
        before, achieved = [], []
        for k in range(a.offsets):
            names = ("oracle", 0, path.stem, k)
            truth = draw_hidden_offset(case.cloud, generator(*names))
            before.append(S.error_of(view, truth, prior))
            achieved.append([S.error_of(view, truth, registrar.register(view.scene, (view.scan(truth, pool[i].path, finger, generator(*names, int(i))),), settings)) for i in chosen])
        with a.out.open("a") as out:
            out.write(json.dumps({"mesh": path.stem, "seconds": seconds[chosen].tolist(), "predicted": predicted.tolist(), "guess": guess[chosen].tolist(), "present": present, "before": before, "achieved": achieved}) + "\n")
        print(path.stem, f"{time.perf_counter() - started:.0f} s", flush=True)


if __name__ == "__main__":
    main()
