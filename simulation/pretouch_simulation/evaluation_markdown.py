"""What an evaluation found, as Markdown: engines side by side, and the objects on which one is worse than another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pretouch.geometry import Array
from pretouch_simulation.evaluation_rows import Run
from pretouch_simulation.evaluation_summary import Summary, by_setup, errors_after, summaries

_HEADINGS = (
    *("sensor", "engine", "scans", "n", "mean", "sd", "median", "p95", "> 1 cm", "covered", "expected", "scanned"),
    *("robot s", "ms p50", "ms p95"),
)


@dataclass(frozen=True)
class Comparison:
    """Two engines on all views of one object by one sensor; mean errors, m."""

    mesh: str
    sensor: str
    n: int
    one: float
    other: float


def engine_table(runs: Sequence[Run], scans: Sequence[int]) -> str:
    """A line per sensor, number of scans and engine; errors in cm. 0 scans is the error before, once per sensor."""
    found = summaries(runs, scans)
    sensors = dict.fromkeys(one.sensor for one in found)
    lines = [_cells(_HEADINGS), _cells(["---"] * len(_HEADINGS))]
    for sensor in sensors:
        for scan in scans:
            at = [one for one in found if (one.sensor, one.scan) == (sensor, scan)]
            lines += [_summary_line(one) for one in (at if scan else at[:1])]
    return "\n".join(lines) + "\n"


def compared(runs: Sequence[Run], scan: int, engine: str, other: str) -> list[Comparison]:
    """Both engines by object and sensor after `scan` scans; where `engine` loses most comes first."""
    groups = by_setup(runs)
    found = []
    for sensor in dict.fromkeys(sensor for _, sensor in groups):
        ours, theirs = (_by_mesh(groups.get((name, sensor), []), scan) for name in (engine, other))
        for mesh in ours.keys() & theirs.keys():
            means = float(ours[mesh].mean()), float(theirs[mesh].mean())
            found.append(Comparison(mesh, sensor, len(ours[mesh]), *means))
    return sorted(found, key=lambda pair: (pair.other - pair.one, pair.mesh, pair.sensor))


def comparison_table(pairs: Sequence[Comparison], engine: str, other: str) -> str:
    """A line for each pair on which `engine` is the worse one, and how often that is; errors in cm."""
    worse = [pair for pair in pairs if pair.one > pair.other]
    lines = [
        f"`{engine}` is worse than `{other}` on {len(worse)} of {len(pairs)} pairs of object and sensor.",
        "",
        _cells(["object", "sensor", "n", engine, other, "difference"]),
        _cells(["---"] * 6),
    ]
    for pair in worse:
        errors = (_cm(value) for value in (pair.one, pair.other, pair.one - pair.other))
        lines.append(_cells([pair.mesh, pair.sensor, str(pair.n), *errors]))
    return "\n".join(lines) + "\n"


def _by_mesh(runs: Sequence[Run], scan: int) -> dict[str, Array]:
    errors: dict[str, list[float]] = {}
    for run, error in zip(runs, errors_after(runs, scan), strict=True):
        errors.setdefault(run.mesh, []).append(float(error))
    return {mesh: np.array(values, dtype=np.float64) for mesh, values in errors.items()}


def _summary_line(one: Summary) -> str:
    errors = [*(_cm(value) for value in (one.mean, one.sd, one.median, one.p95)), f"{one.large:.0%}"]
    if one.scan == 0:
        return _cells([one.sensor, "", "0", str(one.n), *errors, *[""] * 6])
    return _cells(
        [
            *(one.sensor, one.engine, str(one.scan), str(one.n)),
            *errors,
            *(f"{one.covered:.0%}", _cm(one.expected_error), f"{one.fraction:.1%}", f"{one.robot_seconds:.1f}"),
            *(f"{one.compute_p50:.0f}", f"{one.compute_p95:.0f}"),
        ]
    )


def _cells(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _cm(metres: float) -> str:
    return f"{100 * metres:.2f}"
