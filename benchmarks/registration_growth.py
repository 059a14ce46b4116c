"""How the time of a match grows with samples and with target points: figures and a picture.

`python -m benchmarks.registration_growth --out DIR [--repeats R]` writes growth.json and growth.png: the median time of
a match, the target's index built anew each time, with slopes fitted in log-log scale. A wavy surface of 10 cm is
matched after a shift of 5 mm and a turn of 3 degrees; noise 1.5 mm; samples grow at 5,000 target points, target points
at 150 samples.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from pretouch_registrar.engines import icp, pcl, point_to_plane
from pretouch_registrar.engines.neighbours import build_index, subsample

from pretouch.geometry import Array, Pose
from pretouch.prior import Prior

SAMPLES = (100, 200, 500, 1000, 2000, 5000, 10_000)
TARGETS = (1000, 3000, 10_000, 30_000, 100_000, 300_000)
FIXED_SAMPLES, FIXED_TARGETS = 150, 5000
_OFFSET = Pose.from_rotation_vector([0.03, -0.03, 0.03], [0.004, -0.003, 0.002])
_NOISE = 0.0015
_PLANE_NOISE = 0.0025
_SEED = 0


def _surface(count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Points (count, 3) and normals (count, 3) of a wavy sheet."""
    xy = rng.uniform(-0.05, 0.05, (count, 2))
    points = np.column_stack([xy, 0.01 * np.sin(60 * xy[:, 0]) + 0.01 * np.cos(50 * xy[:, 1])])
    slope = np.column_stack([-0.6 * np.cos(60 * xy[:, 0]), 0.5 * np.sin(50 * xy[:, 1]), np.ones(count)])
    return points, slope / np.linalg.norm(slope, axis=1, keepdims=True)


def _point(trimmed: bool) -> Callable[[Array, Array, Array], None]:
    def match(source: Array, target: Array, _: Array) -> None:
        icp.align(source, build_index(subsample(target)), trimmed, np.eye(3), np.zeros(3))

    return match


def _pcl(source: Array, target: Array, _: Array) -> None:
    pcl.align(source, target)


def _point_to_plane(source: Array, target: Array, normals: Array) -> None:
    planes = point_to_plane.make_planes(target, normals)
    prior = np.asarray(np.linalg.inv(Prior().covariance), dtype=np.float64)
    point_to_plane.match(source, np.ones(len(source)), planes, np.zeros(3), prior, _PLANE_NOISE, np.zeros(6))


METHODS: dict[str, Callable[[Array, Array, Array], None]] = {
    "point-to-point": _point(False),
    "paper": _point(True),
    "pcl": _pcl,
    "point_to_plane": _point_to_plane,
}


def _times(sizes: Iterable[tuple[int, int]], repeats: int) -> dict[str, list[float]]:
    """ms of each method for each (samples, target points)."""
    times: dict[str, list[float]] = {name: [] for name in METHODS}
    for samples, targets in sizes:
        rng = np.random.default_rng(_SEED)
        target, normals = _surface(targets, rng)
        source = _OFFSET.apply(_surface(samples, rng)[0]) + rng.normal(0, _NOISE, (samples, 3))
        for name, method in METHODS.items():
            method(source, target, normals)
            seconds = []
            for _ in range(repeats):
                start = time.perf_counter()
                method(source, target, normals)
                seconds.append(time.perf_counter() - start)
            times[name].append(1000 * float(np.median(seconds)))
    return times


def _slopes(sizes: tuple[int, ...], times: dict[str, list[float]]) -> dict[str, float]:
    return {name: float(np.polyfit(np.log(sizes), np.log(ms), 1)[0]) for name, ms in times.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="a folder")
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    options.out.mkdir(parents=True, exist_ok=True)
    runs = {
        "samples": (SAMPLES, _times([(n, FIXED_TARGETS) for n in SAMPLES], options.repeats)),
        "target points": (TARGETS, _times([(FIXED_SAMPLES, n) for n in TARGETS], options.repeats)),
    }
    figure = Figure(figsize=(11, 4.5), layout="constrained")
    document: dict[str, object] = {
        "command": f"python -m benchmarks.registration_growth --out DIR --repeats {options.repeats}",
        "seed": _SEED,
        "fixed": {"samples": FIXED_SAMPLES, "target points": FIXED_TARGETS},
    }
    for axes, (what, (sizes, times)) in zip(figure.subplots(1, 2), runs.items(), strict=True):
        slopes = _slopes(sizes, times)
        for name, ms in times.items():
            axes.loglog(sizes, ms, "o-", label=f"{name}: slope {slopes[name]:.2f}")
            print(f"{what:14} {name:16} slope {slopes[name]:5.2f}  ms " + " ".join(f"{value:.2f}" for value in ms))
        axes.set(xlabel=what, ylabel="ms a match", title=f"Time against {what}")
        axes.grid(which="both", alpha=0.3)
        axes.legend()
        document[what] = {"sizes": sizes, "ms": times, "slopes": slopes}
    figure.savefig(options.out / "growth.png", dpi=120)
    (options.out / "growth.json").write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
