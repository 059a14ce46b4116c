"""The registration benchmark's peers, each in a process of its own, on cases written to a file.

`python -m benchmarks.registration_peers open3d|small_gicp CASES REPEATS OUT` matches all cases and writes, for each
method, seconds (cases,) and matches (cases, 4, 4) to the .npz file OUT. CASES is little endian: int32 n, then for each
case int32 ns, int32 nt, float64 (4, 4) true `target_T_source`, (ns, 3) source, (nt, 3) target and its normals; metres.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.registration_cases import RegistrationCase
from pretouch.geometry import Array

MAX_DISTANCE = 0.05
MAX_ROUNDS = 50
EPSILON = 1e-5
PCL_MODES = {
    "PCL ICP + VarTrimmed": "vartrim",
    "PCL ICP": "plain",
    "PCL ICP + Phillips as published": "vartrimfix",
    "PCL point-to-plane": "p2pl",
    "PCL GICP": "gicp",
}
Result = tuple[Array, Array]
"""Seconds (cases,) and matches (cases, 4, 4)."""


class Missing(Exception):
    """A peer that is not installed or cannot be built."""


def write_cases(cases: Sequence[RegistrationCase], path: Path) -> None:
    with path.open("wb") as file:
        file.write(np.int32(len(cases)).tobytes())
        for case in cases:
            file.write(np.array([len(case.source), len(case.target)], "<i4").tobytes())
            for numbers in (case.target_T_source.matrix, case.source, case.target, case.normals):
                file.write(np.ascontiguousarray(numbers, "<f8").tobytes())


def read_cases(path: Path) -> Iterator[tuple[Array, Array, Array]]:
    """Source, target and normals of each case."""
    data = path.read_bytes()
    at = 4
    for _ in range(int(np.frombuffer(data, "<i4", 1)[0])):
        ns, nt = np.frombuffer(data, "<i4", 2, at)
        at += 8 + 128
        arrays = []
        for count in (ns, nt, nt):
            arrays.append(np.frombuffer(data, "<f8", 3 * count, at).reshape(-1, 3).copy())
            at += 24 * int(count)
        yield arrays[0], arrays[1], arrays[2]


def time_match(match: Callable[[], Array], repeats: int) -> tuple[float, Array]:
    """Median seconds of `match`, and what it answered."""
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        answer = match()
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds)), answer


def run_in_child(peer: str, cases: Path, repeats: int) -> dict[str, Result]:
    """The methods of `open3d` or `small_gicp`, by name.

    Raises:
        Missing: the peer cannot be imported.
    """
    out = cases.with_suffix(f".{peer}.npz")
    words = [sys.executable, "-m", "benchmarks.registration_peers", peer, str(cases), str(repeats), str(out)]
    done = subprocess.run(
        words, env=os.environ | {"OMP_NUM_THREADS": "1"}, capture_output=True, text=True, timeout=1800
    )
    if done.returncode:
        raise Missing(f"{peer}: {(done.stderr.strip().splitlines() or ['no reason given'])[-1]}")
    with np.load(out) as arrays:
        names = [name.removeprefix("seconds ") for name in arrays if name.startswith("seconds ")]
        return {name: (arrays[f"seconds {name}"], arrays[f"matches {name}"]) for name in names}


def pcl(cases: Path, repeats: int, folder: Path, methods: Sequence[str] = tuple(PCL_MODES)) -> dict[str, Result]:
    """PCL's methods, by name, by the C++ program `bench` of `folder`, built first if need be.

    Raises:
        Missing: there is no such program and it cannot be built.
    """
    program = folder / "bench"
    if not program.is_file():
        if not (folder / "bench.cpp").is_file():
            raise Missing(f"PCL: no bench.cpp in {folder}")
        target = cases.parent / "pcl"
        target.mkdir()
        for name in ("bench.cpp", "build.sh"):
            (target / name).write_bytes((folder / name).read_bytes())
        built = subprocess.run(["sh", "build.sh"], cwd=target, capture_output=True, text=True, timeout=900)
        if built.returncode:
            raise Missing(f"PCL: {(built.stderr.strip().splitlines() or ['the build failed'])[0]}")
        program = target / "bench"
    results = {}
    for name in methods:
        mode = PCL_MODES[name]
        table = cases.with_suffix(f".{mode}.csv")
        words = [str(program), str(cases), mode, str(repeats), str(table), str(MAX_DISTANCE), str(MAX_ROUNDS)]
        subprocess.run(words, env=os.environ | {"OMP_NUM_THREADS": "1"}, check=True, capture_output=True, timeout=1800)
        rows = np.loadtxt(table, delimiter=",", ndmin=2)
        matches = np.tile(np.eye(4), (len(rows), 1, 1))
        matches[:, :3] = rows[:, 3:].reshape(-1, 3, 4)
        results[name] = (rows[:, 1] / 1000.0, matches)
    return results


def _open3d() -> dict[str, Callable[[Array, Array, Array], Callable[[], Array]]]:
    from benchmarks.open3d_loader import open3d

    o3d = open3d()
    o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)
    icp = o3d.pipelines.registration
    criteria = icp.ICPConvergenceCriteria(max_iteration=MAX_ROUNDS)

    def method(estimation: Any) -> Callable[[Array, Array, Array], Callable[[], Array]]:
        def prepare(source: Array, target: Array, normals: Array) -> Callable[[], Array]:
            a, b = (o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)) for points in (source, target))
            b.normals = o3d.utility.Vector3dVector(normals)
            return lambda: np.array(
                icp.registration_icp(a, b, MAX_DISTANCE, np.eye(4), estimation, criteria).transformation
            )

        return prepare

    return {
        "Open3D point-to-point": method(icp.TransformationEstimationPointToPoint()),
        "Open3D point-to-plane": method(icp.TransformationEstimationPointToPlane()),
    }


def _small_gicp() -> dict[str, Callable[[Array, Array, Array], Callable[[], Array]]]:
    import small_gicp

    def method(kind: str) -> Callable[[Array, Array, Array], Callable[[], Array]]:
        def prepare(source: Array, target: Array, _: Array) -> Callable[[], Array]:
            a, b = small_gicp.PointCloud(source), small_gicp.PointCloud(target)
            tree = small_gicp.KdTree(b, num_threads=1)
            small_gicp.estimate_normals_covariances(b, tree, num_neighbors=20, num_threads=1)
            small_gicp.estimate_covariances(a, small_gicp.KdTree(a, num_threads=1), num_neighbors=20, num_threads=1)

            def match() -> Array:
                found = small_gicp.align(
                    b, a, tree, np.eye(4), registration_type=kind, max_correspondence_distance=MAX_DISTANCE,
                    num_threads=1, max_iterations=MAX_ROUNDS, rotation_epsilon=EPSILON, translation_epsilon=EPSILON,
                )  # fmt: skip
                return np.array(found.T_target_source)

            return match

        return prepare

    return {f"small_gicp {kind} (prepared)": method(kind) for kind in ("ICP", "PLANE_ICP", "GICP")}


def _main(peer: str, cases: str, repeats: str, out: str) -> None:
    methods = {"open3d": _open3d, "small_gicp": _small_gicp}[peer]()
    arrays: dict[str, Any] = {}
    for name, prepare in methods.items():
        answers = [time_match(prepare(*case), int(repeats)) for case in read_cases(Path(cases))]
        arrays[f"seconds {name}"] = np.array([seconds for seconds, _ in answers])
        arrays[f"matches {name}"] = np.array([match for _, match in answers])
    np.savez(out, **arrays)


if __name__ == "__main__":
    _main(*sys.argv[1:])
