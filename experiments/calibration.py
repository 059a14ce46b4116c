"""Calibrations on real ranges, cross-validated, and mounts and cones found from simulated sweeps of unknown responses.

    python -m experiments.calibration [--ranges DIR] [--fingers 12] [--first 200] [--out docs/results]

Writes calibration.md. DIR is data/real_tof of PRETOUCH_SHARED unless given.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pretouch_sensor_gateway.calibration.drift import HORIZON, SCAN, measure_drift
from pretouch_sensor_gateway.calibration.fit import fit_module
from pretouch_sensor_gateway.calibration.sweep_fit import fit_sweep
from pretouch_simulation.finger import FingerModel, realise
from pretouch_simulation.fingers.cone_finger import ConeFinger
from pretouch_simulation.markdown import markdown_table

from experiments.command_line import command_of, run_or_exit
from experiments.fingers import read_static
from experiments.folders import RESULTS, SHARED
from experiments.sweeps import draw_truth, fly
from pretouch.errors import InvalidInput, NotFound
from pretouch.geometry import Array, Pose

SPANS = ((0.030, 0.100), (0.030, 0.200), (0.030, 0.400))
"""m"""
_HELD_OUT = 5
"""Blocks of neighbouring captures, each left out of a whole calibration; beside that, every capture alone."""
_CENTRE = 4
_STATIC_RATE = 50.0
_MINUTES = (3, 5, 10, 20)
_THIN = 0.02
"""rad: a response narrower than this is a thin beam."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ranges", type=Path, default=SHARED / "data" / "real_tof")
    parser.add_argument("--fingers", type=int, default=12)
    parser.add_argument("--first", type=int, default=200, help="the first finger's seed")
    parser.add_argument("--out", type=Path, default=RESULTS)
    run_or_exit(parser.parse_args(), run)


def run(arguments: argparse.Namespace) -> None:
    """Writes the file.

    Raises:
        NotFound: the real ranges are not there.
    """
    distances, zones = read_plane(arguments.ranges)
    parts = [
        f"# Calibration\n\nBy `{command_of('calibration')}`. What the numbers mean and what they do not is in "
        "[README.md](README.md#calibration).",
        "## Curves: TMF8820\n\nmm. Off by: rms of calibrated ranges at captures in blocks of neighbours that the "
        "calibration was made without, the outermost always in it. z: off by, over the stated standard deviation, rms."
        "\n\n" + _curves(distances, zones),
        "## Beyond the calibrated distances\n\n" + _beyond(distances, zones),
        "## Drift: VL53L0X\n\n" + _drift(read_static(arguments.ranges)),
        "## Sweeps\n\n" + _sweeps(arguments.fingers, arguments.first),
    ]
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "calibration.md").write_text("\n\n".join(parts) + "\n")
    print((arguments.out / "calibration.md").read_text())


def read_plane(folder: Path) -> tuple[Array, Array]:
    """The TMF8820's captures: distances (n,), m, ascending, and readings of the zones (n, 9), m."""
    path = folder / "tmf8820_plane.json"
    if not path.is_file():
        raise NotFound(f"There is no {path}.", "Give --ranges, or set PRETOUCH_SHARED.")
    captures = sorted(json.loads(path.read_text()), key=lambda capture: float(capture["dist_to_plane"]))
    distances = np.array([capture["dist_to_plane"] for capture in captures])
    return distances, np.array([capture["distances"][0]["depths_1"] for capture in captures]) / 1000


class HeldOut(NamedTuple):
    """Of one zone: calibrated ranges at captures left out, minus the distance, and stated std; a line's; m."""

    off: Array
    std: Array
    line: Array


def hold_out(distances: Array, readings: Array, blocks: int) -> HeldOut:
    """Calibrates without each of so many blocks of neighbours in turn; never without the outermost."""
    off, std, line = (np.zeros(0) for _ in range(3))
    for block in np.array_split(np.arange(1, len(distances) - 1), blocks):
        kept = np.setdiff1d(np.arange(len(distances)), block)
        fit = fit_module({float(distances[n]): readings[n : n + 1] for n in kept}).calibration
        ranges = fit.distance(readings[block])
        slope, start = np.polyfit(distances[kept], readings[kept], 1)
        off = np.append(off, ranges - distances[block])
        std = np.append(std, fit.std_at(ranges))
        line = np.append(line, (readings[block] - start) / slope - distances[block])
    return HeldOut(off, std, line)


def _curves(distances: Array, zones: Array) -> str:
    rows = []
    for start, end in SPANS:
        inside = (distances > start - 1e-4) & (distances < end + 1e-4)
        single = int(inside.sum()) - 2
        for blocks in (single, _HELD_OUT):
            found = [hold_out(distances[inside], readings[inside], blocks) for readings in zones.T]
            left_out = f"blocks of {single / blocks:.0f}" if blocks < single else "single"
            for name, parts in (("centre", found[_CENTRE : _CENTRE + 1]), ("all 9", found)):
                off, std, line = (np.concatenate([getattr(part, which) for part in parts]) for which in HeldOut._fields)
                rows.append(
                    [
                        f"{1000 * start:.0f}-{1000 * end:.0f}", left_out, name, str(len(off)), _mm(line), _mm(off),
                        _mm(std), f"{np.sqrt(np.mean((off / std) ** 2)):.2f}",
                        f"{100 * np.mean(np.abs(off) < 1.96 * std):.0f} %",
                    ]
                )  # fmt: skip
    titles = ["distances", "left out", "zones", "n", "line: off by", "curve: off by", "stated std", "z", "within 95 %"]
    return markdown_table(titles, rows)


def _beyond(distances: Array, zones: Array) -> str:
    """The error of a calibration over 30 to 100 mm beyond it."""
    start, end = SPANS[0]
    inside = (distances > start - 1e-4) & (distances < end + 1e-4)
    rows = []
    for low, high in ((0.020, 0.0299), (0.1001, 0.110), (0.1101, 0.130), (0.1301, 0.200)):
        there = (distances > low - 1e-4) & (distances < high + 1e-4)
        off, std = [], []
        for readings in zones.T:
            fit = fit_module(dict(zip(distances[inside].tolist(), readings[inside, None], strict=True))).calibration
            seen = there & (readings > 0)
            ranges = fit.distance(readings[seen])
            off.append(ranges - distances[seen])
            std.append(fit.std_at(ranges))
        errors, stated = np.concatenate(off), np.concatenate(std)
        rows.append(
            [
                f"{1000 * low:.0f}-{1000 * high:.0f}",
                str(len(errors)),
                _mm(errors),
                f"{1000 * np.sqrt(np.mean(stated**2)):.2f}",
            ]
        )
    return "Calibrated at 30 to 100 mm, all 9 zones; mm.\n\n" + markdown_table(
        ["distances", "n", "off by", "stated std"], rows
    )


def _drift(static: Array) -> str:
    each = round(SCAN * _STATIC_RATE)
    hour = static[: len(static) // each * each].reshape(-1, each).mean(axis=1)
    whole = measure_drift(static, _STATIC_RATE)
    rows = []
    for minutes in _MINUTES:
        count = round(60 * minutes * _STATIC_RATE)
        drifts = [
            measure_drift(piece, _STATIC_RATE) for piece in np.split(static, range(count, len(static), count))[:-1]
        ]
        found = np.array([drift.found for drift in drifts])
        stated = np.array([drift.bias_std for drift in drifts])
        rows.append(
            [
                f"{minutes} min",
                str(len(drifts)),
                _of(found),
                _of(stated),
                str(sum(drift.warm_up > 0 for drift in drifts)),
            ]
        )
    rows.append(
        ["67 min", "1", f"{1000 * whole.found:.2f}", f"{1000 * whole.bias_std:.2f}", str(int(whole.warm_up > 0))]
    )
    return (
        f"One reading {1000 * static.std():.2f} mm, its white noise {1000 * whole.white_std:.2f}; means of {SCAN:g} s "
        f"{1000 * hour.std(ddof=1):.2f} over the whole recording, mm. Pieces of it: rms (least to greatest); a warming "
        "up that was seen is a false one.\n\n"
        + markdown_table(["piece", "n", "bias found", f"stated, for {HORIZON / 3600:g} h", "warming up seen"], rows)
    )


class Recovered(NamedTuple):
    """Error and stated standard deviation of one fit: beam's direction (rad), origin (m), latency (s), log width."""

    errors: Array
    stds: Array
    point: float
    thin: bool
    half_angle: float


def recover(model: FingerModel, seed: int) -> Recovered | str:
    """Flies a sweep with a finger drawn by `seed` and fits it; a refusal's detail."""
    rng = np.random.default_rng(seed)
    finger = realise(model, rng)
    assert isinstance(finger, ConeFinger)
    truth, mount = draw_truth(finger, rng)
    sensor = finger.sensor
    try:
        fit, _ = fit_sweep(fly(finger, truth, mount, rng), Pose.identity(), sensor.range_std, sensor.beam_half_angle)
    except InvalidInput as error:
        return error.detail
    stds = np.sqrt(np.diag(fit.covariance))
    true, found = truth.tip_T_module, fit.tip_T_module
    turned = found.rotation[:, 2] - true.rotation[:, 2]
    moved = found.translation - true.translation
    half_angle = finger.response.spot.half_angle
    width = np.log(fit.half_angle / half_angle) if half_angle > _THIN else np.nan
    at = 0.05 * turned + moved
    errors = np.array([-turned[1], turned[0], moved[0], moved[1], fit.latency - truth.latency, width])
    return Recovered(
        errors, stds[[0, 1, 2, 3, 5, 6]], float(np.hypot(at[0], at[1])), half_angle <= _THIN, fit.half_angle
    )


def _sweeps(count: int, first: int) -> str:
    rows, remarks = [], []
    for model in (FingerModel.CONE, FingerModel.RANDOM):
        with ProcessPoolExecutor(2) as pool:
            found = list(pool.map(recover, [model] * count, range(first, first + count)))
        fits = [each for each in found if isinstance(each, Recovered)]
        refused = [each for each in found if isinstance(each, str)]
        remarks.append(f"`{model}`: {len(refused)} of {count} refused.")
        thin = [each for each in fits if each.thin]
        if thin:
            angles = ", ".join(f"{np.degrees(each.half_angle):.1f}" for each in thin)
            remarks.append(f"The {len(thin)} thin beams among them were found {angles} deg wide.")
        rows += _rows_of(model, fits)
    return (
        "The error of what is found against the standard deviation that is stated; nothing is known of the step. rms; "
        "z: their ratio, rms; within: share of the errors in the 95 % interval. " + " ".join(remarks) + "\n\n"
        + markdown_table(["finger", "what", "n", "error", "stated", "z", "within"], rows)
    )  # fmt: skip


def _rows_of(model: FingerModel, fits: Sequence[Recovered]) -> list[list[str]]:
    errors, stds = np.array([fit.errors for fit in fits]), np.array([fit.stds for fit in fits])
    rows: list[list[str]] = []
    for name, columns, unit in (
        ("beam's direction, each axis, deg", [0, 1], float(np.degrees(1))),
        ("origin across the beam, each axis, mm", [2, 3], 1000.0),
        ("latency, ms", [4], 1000.0),
        ("half angle, %", [5], 100.0),
    ):
        known = np.isfinite(errors[:, columns])
        off, std = errors[:, columns][known], stds[:, columns][known]
        rows.append(
            [
                f"`{model}`", name, str(len(off)), f"{unit * np.sqrt(np.mean(off**2)):.1f}",
                f"{unit * np.sqrt(np.mean(std**2)):.1f}", f"{np.sqrt(np.mean((off / std) ** 2)):.2f}",
                f"{100 * np.mean(np.abs(off) < 1.96 * std):.0f} %",
            ]
        )  # fmt: skip
    point = np.array([fit.point for fit in fits])
    rows.append([f"`{model}`", "beam's place at 50 mm, mm", str(len(point)), _mm(point), "", "", ""])
    return rows


def _mm(values: Array) -> str:
    return f"{1000 * np.sqrt(np.mean(values**2)):.2f}"


def _of(values: Array) -> str:
    return f"{_mm(values)} ({1000 * values.min():.2f}-{1000 * values.max():.2f})"


if __name__ == "__main__":
    main()
