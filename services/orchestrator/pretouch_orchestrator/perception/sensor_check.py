"""Whether the modules of a fingertip measured anything in a scan: stuck, dead, noisy, or in another unit.

A verdict needs a contradiction with what the camera saw that no error of the camera explains. Where there is none the
module is believed.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pretouch.estimate import Estimate
from pretouch.geometry import Array
from pretouch.scene import Scene
from pretouch.tof import STATUS_OK, RangeSamples, Scan, Sensor
from pretouch_orchestrator.perception.believed_ranges import Surface

_ENOUGH = 20
"""Samples below which nothing is said: less than a second of most sensors."""
_ENOUGH_OF_A_UNIT = 10
"""The same of a wrong unit, which is off by a factor in each of them."""
_MAX_COMPARED = 300
"""Samples of a module that are compared with the surface, evenly chosen: one every few millimetres."""
_REPORTED = 0.9
"""Share of its samples in which a stuck module reports a range at least: one that gives none in places is alive."""
_LEFT_OUT = 0.05
"""Share of a stuck module's readings that may be anything: a loose line garbles some."""
_CONSTANT = 0.00105
"""m: spread of a stuck module's readings at most: a step of 1 mm, and what rounding adds. Many sensors report whole
millimetres; those that know smaller steps vary by more than that over 20 samples, whatever they see."""
_CONTRADICTED = 0.005
"""m: spread of the ranges that a stuck module should have read at least. Depth cameras see a plane that uneven."""
_WIDE = 1.5
"""How much wider than stated a cone may be that reads its nearest part."""
_NOISE = 0.010
"""m: no module that is fit for a range of centimetres to decimetres is so imprecise."""
_NOISE_RATIO = 8.0
"""The same in standard deviations as stated; who states them is seldom off by more than 2 or 3."""
_SMOOTH = 0.005
"""m: second difference of the ranges expected at three samples in a row, at most, over a smooth surface."""
_SECOND_DIFFERENCE = np.sqrt(6.0)
"""Standard deviation of x - 2 y + z for independent ones."""
_MAD = 1.4826
"""Standard deviations of a normal distribution in its median absolute deviation."""
_FACTORS = (0.001, 0.01, 0.1, 10.0, 100.0, 1000.0)
"""By which readings in other units are to be multiplied."""
_SAME_SCALE = np.log(2.5)
"""By which factor a range may be off its expectation without doubt about the unit; one of 10 leaves 4 then."""
_CODES = 2
"""Different numbers that may stand for "no target", as 8190 and 8191 do for the VL53L0X."""
_LEVEL = 0.02
"""m that a constant reading may be off its expectation besides what the estimate leaves uncertain: a module with a
large offset is not stuck."""
_UNLIKELY = 0.02
"""Probability, by the present estimate, up to which an explanation by the camera's error is dismissed."""
_CERTAIN = 20
"""Samples that would have to come back: of so many a dark or steep place swallows some, not all."""
_SIGMAS = 3.0
"""Standard deviations of a range by which the surface must be within range to be sure of a return."""
_TOLD = 3
"""Modules of which a sentence is told."""


class Fault(StrEnum):
    STUCK = "stuck"
    NOISE = "noise"
    UNIT = "unit"
    DEAD = "dead"


class Verdict(NamedTuple):
    """What is wrong with a module: `text` is a sentence with the numbers and, where it is known, the way out."""

    module: int
    fault: Fault
    text: str


class _Readings(NamedTuple):
    """One module's samples in a scan, and the ranges that it should have read.

    Attributes:
        name: what the module is called in a sentence.
        values: (n,), m, as reported; NaN where it reported none.
        returned: (n,): a range within the sensor's own.
        origins, directions: (n, 3), in base, m and unit.
        expected: (n,), m.
        known: (n,): the surface there was seen.
        doubted: no module measured anything in the scan before.
        missed: the samples as beams, together with all earlier ones where none of these has come back.
    """

    name: str
    values: Array
    returned: NDArray[np.bool_]
    origins: Array
    directions: Array
    expected: Array
    known: NDArray[np.bool_]
    doubted: bool
    missed: Scan


def judge(
    samples: RangeSamples, sensor: Sensor, scene: Scene, estimate: Estimate, before: Sequence[Scan] = ()
) -> tuple[Verdict, ...]:
    """The modules that measured nothing in a scan, each with what is wrong; those not named are to be believed.

    Args:
        samples: the scan, as it was sent; modules that the sensor does not have are passed over.
        scene, estimate: what was believed before the scan.
        before: the scans before it, as far as they were believed.
    """
    modules = [k for k in np.unique(samples.module).tolist() if k < len(sensor.tip_T_module)]
    if not modules:
        return ()
    surface = Surface.of(scene, estimate)
    earlier = Scan.concatenate(list(before))
    verdicts = []
    for module in modules:
        readings = _readings(samples, sensor, surface, module, bool(estimate.sensor_problem), earlier)
        for fault, find in _CHECKS.items():
            if text := find(readings, sensor, surface):
                verdicts.append(Verdict(module, fault, f"{readings.name} {text}"))
                break
    return tuple(verdicts)


def without(samples: RangeSamples, modules: Collection[int]) -> RangeSamples:
    """The samples of all other modules."""
    if not modules:
        return samples
    kept = ~np.isin(samples.module, list(modules))
    return RangeSamples(
        samples.t[kept], samples.base_T_tip[kept], samples.range[kept], samples.status[kept], samples.module[kept]
    )


def told(verdicts: Sequence[Verdict]) -> str:
    """Why a scan of which no module measured anything is no evidence."""
    texts = [verdict.text for verdict in verdicts[:_TOLD]]
    if len(verdicts) > _TOLD:
        texts.append(f"The other {len(verdicts) - _TOLD} modules measure nothing either.")
    return " ".join(texts)


def _readings(
    samples: RangeSamples, sensor: Sensor, surface: Surface, module: int, doubted: bool, earlier: Scan
) -> _Readings:
    chosen = samples.module == module
    values = np.where(samples.status[chosen] == STATUS_OK, samples.range[chosen], np.nan)
    base_T_module = samples.base_T_tip[chosen] @ sensor.tip_T_module[module].matrix
    origins, directions = base_T_module[:, :3, 3], base_T_module[:, :3, 2]
    beams = Scan(origins, directions, np.full(len(origins), np.nan))
    return _Readings(
        "The sensor" if len(sensor.tip_T_module) == 1 else f"Module {module}",
        values,
        (values >= sensor.range_min) & (values <= sensor.range_max),
        origins,
        directions,
        surface.ranges(origins, directions),
        surface.known_at(origins, directions),
        doubted=doubted,
        missed=beams if earlier.returned.any() else Scan.concatenate([earlier, beams]),
    )


def _unit(readings: _Readings, sensor: Sensor, _: Surface) -> str:
    """Ranges beyond the sensor's own that are as expected once they are multiplied by a power of ten."""
    reported = np.isfinite(readings.values) & (readings.values > 0)
    off = reported & ~readings.returned
    compared = off & readings.known & (readings.expected > 0)
    if compared.sum() < _ENOUGH_OF_A_UNIT or 2 * off.sum() <= reported.sum():
        return ""
    values, expected = readings.values[compared], readings.expected[compared]
    if len(np.unique(values)) <= _CODES:
        return ""
    middle = float(np.median(values))
    for factor in _FACTORS:
        scaled = factor * values
        inside = (scaled >= sensor.range_min) & (scaled <= sensor.range_max)
        if 2 * inside.sum() > len(values) and np.median(np.abs(np.log(scaled / expected))) <= _SAME_SCALE:
            change = f"divided by {1 / factor:.0f}" if factor < 1 else f"multiplied by {factor:.0f}"
            return (
                f"reads {middle:.4g} m where {np.median(expected):.3f} m are expected (medians of {len(values)} "
                f"samples); {change} its ranges fit: send metres."
            )
    return ""


def _dead(readings: _Readings, sensor: Sensor, surface: Surface) -> str:
    """No return, from where some of the surface is within range almost certainly."""
    origins, directions = readings.missed.origins, readings.missed.directions
    n = len(origins)
    if n < _ENOUGH or readings.returned.any():
        return ""
    some = _some(n)
    furthest = sensor.range_max - _SIGMAS * sensor.range_std
    within = surface.drawn_ranges(origins[some], directions[some]) <= furthest
    count = float(np.quantile(within.mean(axis=1), _UNLIKELY, method="lower")) * n
    if count < _CERTAIN:
        return ""
    values = readings.values[np.isfinite(readings.values)]
    reads = "gives no range" if len(values) == 0 else f"gives no range but {np.median(values):.4g} m"
    return (
        f"{reads} in any of {n} samples while the surface is within {1000 * sensor.range_max:g} mm of {count:.0f} of "
        f"them or more with a probability of {1 - _UNLIKELY:.0%}: it is dead, or cannot see this material."
    )


def _stuck(readings: _Readings, sensor: Sensor, surface: Surface) -> str:
    """One and the same range over a surface that cannot be everywhere as far away, or after a scan of no use."""
    reported = np.flatnonzero(np.isfinite(readings.values))
    if len(reported) < max(_ENOUGH, _REPORTED * len(readings.values)):
        return ""
    constant, spread = _narrowest(readings.values[reported])
    if spread > _CONSTANT:
        return ""
    count = int((np.abs(readings.values[reported] - constant) <= _CONSTANT).sum())
    reads = f"reads {1000 * constant:.1f} mm in {count} of {len(reported)} samples"
    if readings.doubted:
        return f"{reads} after a scan that was no better: it is stuck."
    chosen = reported[readings.known[reported]]
    if len(chosen) < _ENOUGH:
        return ""
    some = chosen[_some(len(chosen))]
    variation, off = _drawn_contradictions(readings, some, sensor, surface, constant)
    if ((variation <= _CONTRADICTED) & (off <= _LEVEL)).any(axis=0).mean() > _UNLIKELY:
        return ""
    low, middle, high = np.quantile(readings.expected[some], (0.1, 0.5, 0.9))
    does = f"varies by {1000 * (high - low):.0f} mm"
    if high - low <= _CONTRADICTED:
        does = f"is {1000 * middle:.0f} mm away"
    return f"{reads} while the surface that the camera saw under it {does}: it is stuck."


def _noise(readings: _Readings, sensor: Sensor, _: Surface) -> str:
    """Ranges that jump from one sample to the next over a smooth surface."""
    kept, expected = readings.returned & readings.known, readings.expected
    in_a_row = kept[:-2] & kept[1:-1] & kept[2:]
    smooth = in_a_row & (np.abs(np.diff(expected, 2)) <= _SMOOTH)
    if smooth.sum() < _ENOUGH:
        return ""
    jumps = np.diff(readings.values, 2)[smooth]
    noise = float(_MAD * np.median(np.abs(jumps)) / _SECOND_DIFFERENCE)
    if noise < max(_NOISE, _NOISE_RATIO * sensor.range_std):
        return ""
    return (
        f"varies by {1000 * noise:.0f} mm from one sample to the next over a smooth surface ({smooth.sum()} places), "
        f"{1000 * sensor.range_std:.2g} mm being stated: this is noise."
    )


_CHECKS = {Fault.UNIT: _unit, Fault.DEAD: _dead, Fault.STUCK: _stuck, Fault.NOISE: _noise}


def _narrowest(values: Array) -> tuple[float, float]:
    """The middle, m, and the width, m, of the narrowest span that holds all of values (n,) but the few left out."""
    ordered = np.sort(values)
    held = len(values) - int(_LEFT_OUT * len(values))
    widths = ordered[held - 1 :] - ordered[: len(values) - held + 1]
    first = int(np.argmin(widths))
    return float(np.median(ordered[first : first + held])), float(widths[first])


def _drawn_contradictions(
    readings: _Readings, chosen: NDArray[np.intp], sensor: Sensor, surface: Surface, constant: float
) -> tuple[Array, Array]:
    """How little the ranges expected at the `chosen` samples are the `constant` one, m.

    A constant at the end of the sensor's range or beyond may be its way to say that there is nothing within it.

    Returns:
        The spread of the ranges and their middle's distance from the constant, each (c, k), m: for a thin beam and,
        where the sensor has a cone, one that reads the nearest part of it; for each of the surface's places.
    """
    origins, directions = readings.origins[chosen], readings.directions[chosen]
    surfaces = [surface]
    if sensor.beam_half_angle > 0:
        distance = min(float(np.median(readings.expected[chosen])), sensor.range_max)
        surfaces.append(surface.widened(distance * float(np.tan(_WIDE * sensor.beam_half_angle))))
    drawn = np.stack([candidate.drawn_ranges(origins, directions) for candidate in surfaces])
    if constant >= sensor.range_max - _CONSTANT:
        drawn = np.where(drawn >= sensor.range_max, constant, drawn)
    low, middle, high = np.quantile(drawn, (0.1, 0.5, 0.9), axis=-1)
    return high - low, np.abs(middle - constant)


def _some(count: int) -> NDArray[np.intp]:
    """Which of `count` samples are compared."""
    return np.unique(np.linspace(0, count - 1, min(count, _MAX_COMPARED)).astype(np.intp))
