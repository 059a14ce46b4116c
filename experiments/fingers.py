"""Simulated fingertips beside real time-of-flight modules, and their readings over an edge and a bar.

    python -m experiments.fingers [--ranges DIR] [--fingers 200] [--seed 0] [--out docs/results]

Writes fingers.md and fingers.png. DIR is data/real_tof of PRETOUCH_SHARED unless given.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pretouch_simulation.finger import Finger, FingerModel, measure_scan, realise
from pretouch_simulation.markdown import markdown_table
from pretouch_simulation.protocol import TABLE, generator
from pretouch_simulation.world import World

from experiments.command_line import command_of, run_or_exit
from experiments.fingers_picture import face_down, save_picture
from experiments.folders import RESULTS, SHARED
from pretouch.errors import NotFound
from pretouch.geometry import Array

DISTANCES = np.arange(0.030, 0.0901, 0.005)
"""m: distances at which the TMF8820 was compared with the arm, within the range of all fingers."""
STATIC_AT = 0.076
"""m: where the VL53L0X stood."""
SECONDS = (0.5, 2.0, 6.0, 20.0)
"""Averaging times; a scan takes some seconds."""
FOREIGN = (FingerModel.CONE, FingerModel.RANDOM)
_STATIC_RATE = 50.0
_REPEATS = 200
_WANDERING, _SCANS = 20, 10
_SHOWN = 6
_DEGREES = (0, 1, 3)
_PERCENTILES = (5, 95)
_ONE_SIGMA = 0.683


@dataclass(frozen=True, eq=False)
class Walls:
    """The readings of fingers of one model on perpendicular walls.

    Attributes:
        errors: (f, d), m: reading minus distance of each finger at each of `DISTANCES`, noise averaged out; of the
            fingers that read something at each.
        missing: the number of other fingers.
        wander: (s,), m: for each of `SECONDS`, the standard deviation between scans of means over that time.
        single: m, standard deviation of single readings.
    """

    errors: Array
    missing: int
    wander: Array
    single: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ranges", type=Path, default=SHARED / "data" / "real_tof")
    parser.add_argument("--fingers", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=RESULTS)
    run_or_exit(parser.parse_args(), run)


def run(arguments: argparse.Namespace) -> None:
    """Writes both files.

    Raises:
        NotFound: the real ranges are not there.
    """
    zones, static = read_zones(arguments.ranges), read_static(arguments.ranges)
    walls = {model: measure_walls(fingers_of(model, arguments.fingers, arguments.seed)) for model in FingerModel}
    out: Path = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    command = command_of("fingers")
    (out / "fingers.md").write_text(text(command, zones, static, walls))
    curves = {"TMF8820, 9 zones": zones} | {f"{model}, 9 fingers": walls[model].errors for model in FOREIGN}
    wander = {"VL53L0X": std_of_means(static, _STATIC_RATE)} | {model.value: walls[model].wander for model in walls}
    shown = fingers_of(FingerModel.RANDOM, _SHOWN, arguments.seed)
    save_picture(
        {name: (DISTANCES, errors) for name, errors in curves.items()},
        {name: (SECONDS, values) for name, values in wander.items()},
        shown,
        out / "fingers.png",
    )
    print((out / "fingers.md").read_text())


def read_zones(folder: Path) -> Array:
    """(9, d), m: each of the TMF8820's zones' reading minus the arm's distance, at `DISTANCES`."""
    captures = json.loads(_check_exists(folder / "tmf8820_plane.json").read_text())
    by_distance = {round(1000 * capture["dist_to_plane"]): capture["distances"][0]["depths_1"] for capture in captures}
    depths = np.array([by_distance[round(1000 * distance)] for distance in DISTANCES], dtype=np.float64).T / 1000
    return np.asarray(np.where(depths > 0, depths, np.nan) - DISTANCES, dtype=np.float64)


def read_static(folder: Path) -> Array:
    """(n,), m: the VL53L0X's readings of one hour at 50 Hz."""
    return np.asarray(np.loadtxt(_check_exists(folder / "vl53l0x_static_1h.csv"), skiprows=3) / 1000, dtype=np.float64)


def _check_exists(path: Path) -> Path:
    if not path.is_file():
        raise NotFound(f"There is no {path}.", "Give --ranges, or set PRETOUCH_SHARED.")
    return path


def fingers_of(model: FingerModel, count: int, seed: int) -> list[Finger]:
    """The first `count` fingers of the model."""
    return [realise(model, generator("finger-model", seed, k)) for k in range(count)]


def measure_walls(fingers: Sequence[Finger]) -> Walls:
    """Measures the table from above."""
    errors = np.stack([_measure_errors(finger, generator("wall", k)) for k, finger in enumerate(fingers)])
    there = np.isfinite(errors).all(axis=1)
    scans = [
        [_measure(finger, np.full(round(SECONDS[-1] * finger.sensor.rate), STATIC_AT), generator("static", k, scan))]
        for k, finger in enumerate(fingers[:_WANDERING])
        for scan in range(_SCANS)
    ]
    static = np.array(scans).reshape(-1, _SCANS, len(scans[0][0]))
    static = static[np.isfinite(static).mean(axis=(1, 2)) > 0.5]
    counts = [max(1, round(seconds * fingers[0].sensor.rate)) for seconds in SECONDS]
    wander = [np.sqrt(trimmed_mean(static[..., :count]).var(axis=1).mean()) for count in counts]
    off = np.abs(static - np.nanmedian(static, axis=2, keepdims=True))
    single = float(np.sqrt(np.mean(np.nanquantile(off, _ONE_SIGMA, axis=2) ** 2)))
    return Walls(errors[there], int((~there).sum()), np.array(wander), single)


def _measure_errors(finger: Finger, rng: np.random.Generator) -> Array:
    readings = _measure(finger, np.repeat(DISTANCES, _REPEATS), rng).reshape(len(DISTANCES), _REPEATS)
    enough = np.isfinite(readings).mean(axis=1) > 0.5
    means = np.where(enough, trimmed_mean(np.where(enough[:, None], readings, 0.0)), np.nan)
    return np.asarray(means - DISTANCES, dtype=np.float64)


def trimmed_mean(readings: Array) -> Array:
    """(...), m: trimmed means of readings (..., n), NaN = none, without the outer fifth, which removes outliers."""
    low, high = np.nanquantile(readings, (0.1, 0.9), axis=-1, keepdims=True)
    inner = np.where((readings >= low) & (readings <= high), readings, np.nan)
    return np.asarray(np.nanmean(inner, axis=-1), dtype=np.float64)


def _measure(finger: Finger, distances: Array, rng: np.random.Generator) -> Array:
    ranges, _ = measure_scan(finger, World([], TABLE), face_down(np.zeros(len(distances)), distances), rng)
    return ranges


def std_of_means(readings: Array, rate: float) -> Array:
    """(s,), m: for each of `SECONDS`, the standard deviation of the means of readings (n,) over that time."""
    found = []
    for seconds in SECONDS:
        count = max(1, round(seconds * rate))
        found.append(readings[: len(readings) // count * count].reshape(-1, count).mean(axis=1).std())
    return np.array(found)


def residuals_of_fits(errors: Array, degree: int) -> Array:
    """(f,), m rms: residuals of polynomials of the degree fitted to each finger's errors (f, d)."""
    residuals = []
    for row in errors:
        fit = np.polynomial.Polynomial.fit(DISTANCES, row, degree)
        residuals.append(np.sqrt(((row - fit(DISTANCES)) ** 2).sum() / (len(row) - degree - 1)))
    return np.array(residuals)


def legendre_components(errors: Array) -> Array:
    """(5,), m, rms over fingers: the Legendre components of degree 0 to 4 of errors (f, d), normalised to their rms."""
    places = (2 * DISTANCES - DISTANCES[0] - DISTANCES[-1]) / (DISTANCES[-1] - DISTANCES[0])
    basis = np.polynomial.legendre.legvander(places, 4) * np.sqrt(2 * np.arange(5) + 1)
    components = np.linalg.lstsq(basis, errors.T, rcond=None)[0]
    return np.asarray(np.sqrt((components**2).mean(axis=1)), dtype=np.float64)


def text(command: str, zones: Array, static: Array, walls: dict[FingerModel, Walls]) -> str:
    """The page."""
    rows = [_curve_row("TMF8820, its 9 zones, as read", zones)]
    rows += [_curve_row(f"`{model}`, {len(wall.errors)} fingers", wall.errors) for model, wall in walls.items()]
    header = ["", "offset", "line", "cubic", *(f"degree {degree}" for degree in range(1, 5))]
    times = [_time_row("VL53L0X", static.std(), std_of_means(static, _STATIC_RATE))]
    times += [_time_row(f"`{model}`", wall.single, wall.wander) for model, wall in walls.items()]
    dark = walls[FingerModel.RANDOM].missing
    return "\n".join(
        [
            "# Simulated fingertips beside real modules\n",
            f"Made by `{command}`, from data/real_tof (SOURCES.md there). All in mm.\n",
            "## The error over the range\n",
            "Readings of perpendicular walls from 30 to 90 mm, every 5 mm: the rms that an offset, a line and a cubic "
            "leave, mean (5th to 95th percentile) over zones or fingers; and the Legendre components of the error over "
            "that span, as the rms that each adds. The TMF8820's are single captures in steps of 1 mm (0.29 rms by "
            "themselves), uncalibrated; the simulated fingers are calibrated, and means of 200 readings without the "
            "outer fifth.\n",
            markdown_table(header, rows),
            f"{dark} of the random fingers read nothing on a part of the span: a dark table.\n",
            "Over 30 to 100 mm the TMF8820's second degree is 0.7 mm rms, of one sign in all zones, and each higher "
            "one 0.2: that is what a line leaves, and a cubic what the higher degrees hold. `random` draws one or the "
            "other, over the span of its own range.\n",
            "## What the ranges of a scan share\n",
            f"Standard deviations on a wall that stands still, {1000 * STATIC_AT:.0f} mm away: of single readings, and "
            "between means over a time (of the simulated fingers: between scans, each without its outer fifth).\n",
            markdown_table(["", "single", *(f"{seconds:g} s" for seconds in SECONDS)], times),
            "White noise of 2.15 mm would leave 0.12 after 6 s of the VL53L0X; what does not average out is the bias "
            "that all ranges of a scan share.\n",
            "## Over an edge and a bar\n",
            "![What each finger reads](fingers.png)\n",
        ]
    )


def _curve_row(name: str, errors: Array) -> list[str]:
    cells = []
    for degree in _DEGREES:
        rest = 1000 * residuals_of_fits(errors, degree)
        low, high = np.percentile(rest, _PERCENTILES)
        cells.append(f"{rest.mean():.2f} ({low:.2f}-{high:.2f})")
    return [name, *cells, *(f"{1000 * share:.2f}" for share in legendre_components(errors)[1:])]


def _time_row(name: str, single: float, wander: Array) -> list[str]:
    return [name, f"{1000 * single:.2f}", *(f"{1000 * value:.2f}" for value in wander)]


if __name__ == "__main__":
    main()
