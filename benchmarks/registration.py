"""One scan's match: our kernels and engines beside PCL, Open3D and small_gicp, on the same cases, on one core.

`python -m benchmarks.registration --json OUT [--cases N] [--seed S] [--repeats R] [--meshes DIR] [--pcl DIR]`

Timed is the match from points in memory to a motion, the median of the repeats for each case; ratios are of means over
the cases. PCL, Open3D and our kernels build the target's search structure each time; those marked `prepared` find it
ready, as in a service that knows the image. The engines `point_to_plane` and `posterior` match the same source with all
that the camera saw of the object, from a model that is built once an image, whose time is given apart.
A peer that is not installed is named and left out.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pretouch_registrar.engines import Engine, camera_model, icp, pcl, point_to_plane, solve
from pretouch_registrar.engines.neighbours import Index, build_index
from pretouch_registrar.engines.registration_problem import build_problem
from pretouch_registrar.engines.resources import Resources
from pretouch_registrar.engines.solution import pose_from_correction

from benchmarks import registration_peers as peers
from benchmarks.registration_cases import RegistrationCase, make_cases
from pretouch.geometry import Array, Pose
from pretouch.prior import Prior
from pretouch.tof import Scan, Sensor

REFERENCE = "PCL ICP + VarTrimmed"
PLANE = ("point-to-plane", "PLANE_ICP", "GICP", "point_to_plane", "posterior")
"""Words in the names of methods that know normals; the others match points with points."""
_PLANE_NOISE = 0.0025


def measure(cases: list[RegistrationCase], repeats: int, pcl_folder: Path) -> dict[str, Any]:
    """A row for each method, what was skipped, and the model's build time."""
    skipped: list[str] = []
    results: dict[str, peers.Result] = {}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "cases.bin"
        peers.write_cases(cases, file)
        runs: list[Callable[[], dict[str, peers.Result]]] = [
            lambda: peers.pcl(file, repeats, pcl_folder),
            lambda: peers.run_in_child("open3d", file, repeats),
            lambda: peers.run_in_child("small_gicp", file, repeats),
        ]
        for run in runs:
            try:
                results |= run()
            except peers.Missing as missing:
                skipped.append(str(missing))
                print(f"skipped  {missing}", flush=True)
    theirs = set(results)
    for name, prepare in _ours(Resources()).items():
        prepare(cases[0])()
        answers = [peers.time_match(prepare(case), repeats) for case in cases]
        results[name] = (np.array([seconds for seconds, _ in answers]), np.array([match for _, match in answers]))
    rows = [_row(name, result, cases) for name, result in results.items()]
    for row in rows:
        rivals = [r["ms_mean"] for r in rows if r["method"] in theirs and r["normals"] == row["normals"]]
        reference = [r["ms_mean"] for r in rows if r["method"] == REFERENCE]
        row["ratio_to_pcl"] = reference[0] / row["ms_mean"] if reference else None
        row["ratio_to_fastest_peer"] = min(rivals) / row["ms_mean"] if rivals else None
    return {"rows": rows, "skipped": skipped, "model_build_ms": _model_build(cases)}


def _ours(resources: Resources) -> dict[str, Callable[[RegistrationCase], Callable[[], Array]]]:
    def points(name: str, prepared: bool) -> Callable[[RegistrationCase], Callable[[], Array]]:
        def prepare(case: RegistrationCase) -> Callable[[], Array]:
            target = case.target.astype(np.float32).astype(np.float64) if name == "pcl" else case.target
            known = build_index(target)

            def match() -> Array:
                r, t = np.eye(3), np.zeros(3)
                index: Index = known if prepared else build_index(target)
                if name == "pcl":
                    pcl.match(case.source, index, r, t)
                else:
                    icp.align(case.source, index, name == "paper", r, t)
                return _matrix(r, t)

            return match

        return prepare

    def planes(prepared: bool) -> Callable[[RegistrationCase], Callable[[], Array]]:
        prior = np.asarray(np.linalg.inv(Prior().covariance), dtype=np.float64)

        def prepare(case: RegistrationCase) -> Callable[[], Array]:
            known = point_to_plane.make_planes(case.target, case.normals)
            centroid = case.model.scene.centroid
            shares = np.ones(len(case.source))

            def match() -> Array:
                planes = known if prepared else point_to_plane.make_planes(case.target, case.normals)
                x = np.zeros(6)
                point_to_plane.match(case.source, shares, planes, centroid, prior, _PLANE_NOISE, x)
                return pose_from_correction(x, centroid).inverse().matrix

            return match

        return prepare

    def engine(name: Engine) -> Callable[[RegistrationCase], Callable[[], Array]]:
        def prepare(case: RegistrationCase) -> Callable[[], Array]:
            scan = Scan.of_points(case.source, -case.model.scene.table.normal)
            problem = build_problem(case.model, [scan], Prior(), Sensor())
            solve(name, problem, case.model, resources)
            centroid = problem.target.centroid
            return lambda: (
                pose_from_correction(solve(name, problem, case.model, resources).x, centroid).inverse().matrix
            )

        return prepare

    kernels = {f"ours {name}": points(name, False) for name in ("point-to-point", "paper", "pcl")}
    kernels |= {f"ours {name} (prepared)": points(name, True) for name in ("point-to-point", "paper", "pcl")}
    kernels |= {"ours point_to_plane": planes(False), "ours point_to_plane (prepared)": planes(True)}
    return kernels | {f"engine {name.value}": engine(name) for name in Engine}


def _matrix(r: Array, t: Array) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = r, t
    return matrix


def _row(name: str, result: peers.Result, cases: list[RegistrationCase]) -> dict[str, Any]:
    seconds, matches = result
    error = np.array([case.error(match) for case, match in zip(cases, matches, strict=True)])
    whole = np.array([case.object_error(_inverse(match)) for case, match in zip(cases, matches, strict=True)])
    return {
        "method": name,
        "normals": any(word in name for word in PLANE),
        "n": len(cases),
        "ms_mean": 1000 * float(seconds.mean()),
        "ms_median": 1000 * float(np.median(seconds)),
        "error_mean_m": float(error.mean()),
        "error_median_m": float(np.median(error)),
        "error_p95_m": float(np.percentile(error, 95)),
        "over_1cm": float((error > 0.01).mean()),
        "object_error_mean_m": float(whole.mean()),
        "object_error_median_m": float(np.median(whole)),
        "object_error_p95_m": float(np.percentile(whole, 95)),
    }


def _inverse(match: Array) -> Pose:
    """The correction that a match stands for; the nearest rotation, since peers answer in single precision."""
    u, _, vt = np.linalg.svd(match[:3, :3])
    return Pose.of(u @ vt, match[:3, 3]).inverse()


def _model_build(cases: list[RegistrationCase]) -> float:
    """ms, median over the images."""
    scenes = list({id(case.model): case.model.scene for case in cases}.values())
    seconds = []
    for scene in scenes:
        start = time.perf_counter()
        camera_model.build(scene)
        seconds.append(time.perf_counter() - start)
    return 1000 * float(np.median(seconds))


def find_shared_peers() -> Path:
    """The default folder of PCL's bench program."""
    shared = os.environ.get("PRETOUCH_SHARED") or Path(__file__).resolve().parents[2] / "shared"
    return Path(shared) / "peers" / "pcl"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, required=True)
    parser.add_argument("--cases", type=int, default=240)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--meshes", type=Path, help="a folder of meshes instead of the objects made in code")
    parser.add_argument("--pcl", type=Path, default=find_shared_peers(), help="folder of PCL's bench or bench.cpp")
    parser.add_argument("--core", type=int, help="the processor to run on; default: the last one allowed")
    options = parser.parse_args()
    core = options.core if options.core is not None else max(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {core})
    cases = make_cases(options.cases, options.seed, options.meshes)
    sizes = {
        name: [int(np.percentile([len(getattr(case, name)) for case in cases], q)) for q in (5, 50, 95)]
        for name in ("source", "target")
    }
    figures = measure(cases, options.repeats, options.pcl)
    print(f"{len(cases)} cases, seed {options.seed}; points p5, median, p95: {sizes}; one core")
    print(f"the camera's model takes {figures['model_build_ms']:.1f} ms an image, once")
    head = ("method", "ms", "x PCL", "x fastest", "mean cm", "median", "p95", "> 1 cm", "object: mean", "median")
    print(("{:34}" + "{:>10}" * 9).format(*head))
    for row in figures["rows"]:
        ratios = [f"{row[key]:.2f}" if row[key] else "-" for key in ("ratio_to_pcl", "ratio_to_fastest_peer")]
        errors = [f"{100 * row[f'error_{key}_m']:.2f}" for key in ("mean", "median", "p95")]
        whole = [f"{100 * row[f'object_error_{key}_m']:.2f}" for key in ("mean", "median")]
        cells = [f"{row['ms_mean']:.3f}", *ratios, *errors, f"{100 * row['over_1cm']:.0f} %", *whole]
        print(("{:34}" + "{:>10}" * 9).format(row["method"], *cells))
    command = shlex.join(["python", "-m", "benchmarks.registration", *sys.argv[1:]])
    document = {"command": command, "seed": options.seed, "n": len(cases), "points": sizes, **figures}
    options.json.write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
