"""Engines compared object by object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pretouch.geometry import Array
from pretouch_simulation.evaluation_rows import Run
from pretouch_simulation.evaluation_summary import Setup, errors_after, group_by_setup
from pretouch_simulation.evaluation_table import Table


@dataclass(frozen=True)
class Comparison:
    """Two engines on all views of one object by one camera and sensor; mean errors, m."""

    mesh: str
    sensor: str
    camera: str
    n: int
    one: float
    other: float


def compare_engines(runs: Sequence[Run], scan: int, engine: str, other: str) -> list[Comparison]:
    """Both engines by object, camera and sensor after `scan` scans, sorted by how much worse `engine` is."""
    groups = group_by_setup(runs)
    found = []
    for camera, sensor in dict.fromkeys(setup.world for setup in groups):
        ours, theirs = (_group_by_mesh(groups.get(Setup(name, sensor, camera), []), scan) for name in (engine, other))
        for mesh in ours.keys() & theirs.keys():
            means = float(ours[mesh].mean()), float(theirs[mesh].mean())
            found.append(Comparison(mesh, sensor, camera, len(ours[mesh]), *means))
    return sorted(found, key=lambda pair: (pair.other - pair.one, pair.mesh, pair.sensor, pair.camera))


def comparison_table(pairs: Sequence[Comparison], engine: str, other: str) -> str:
    """A line for each pair on which `engine` is the worse one, and how often that is; errors in cm."""
    worse = [pair for pair in pairs if pair.one > pair.other]
    headings = ("object", "camera", "sensor", "n", engine, other, "difference")
    cells = [
        (
            *(pair.mesh, pair.camera, pair.sensor, str(pair.n)),
            *(f"{100 * value:.2f}" for value in (pair.one, pair.other, pair.one - pair.other)),
        )
        for pair in worse
    ]
    said = f"`{engine}` is worse than `{other}` on {len(worse)} of {len(pairs)} pairs of object and sensor."
    return f"{said}\n\n{Table('', headings, tuple(cells)).to_markdown()}"


def _group_by_mesh(runs: Sequence[Run], scan: int) -> dict[str, Array]:
    errors: dict[str, list[float]] = {}
    for run, error in zip(runs, errors_after(runs, scan), strict=True):
        errors.setdefault(run.mesh, []).append(float(error))
    return {mesh: np.array(values, dtype=np.float64) for mesh, values in errors.items()}
