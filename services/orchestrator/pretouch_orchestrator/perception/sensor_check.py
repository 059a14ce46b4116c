"""Finds the modules of a fingertip that measured nothing of the scene in a scan.

They are stuck, dead, noisy, in a wrong unit, or they look at the robot itself.

A module is diagnosed only if its readings contradict the depth image by more than any likely pose error explains.
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

_MIN_SAMPLES = 20
"""Least samples for a diagnosis: less than a second of most sensors."""
_MIN_UNIT_SAMPLES = 10
"""The same for a wrong unit, which shows in every sample."""
_MAX_COMPARED = 300
"""Samples of a module that are compared with the surface, evenly spaced: one every few millimetres."""
_MIN_REPORTED = 0.9
"""Least share of samples in which a stuck module reports a range: a module that misses some of them is alive."""
_MAX_OUTLIERS = 0.05
"""Share of a stuck module's readings that may be outliers: a loose wire corrupts some."""
_MAX_STUCK_SPREAD = 0.00105
"""m: largest spread of a stuck module's readings: a step of 1 mm, and rounding. Many sensors report whole
millimetres; the noise of those with a finer resolution exceeds it within 20 samples."""
_MIN_EXPECTED_SPREAD = 0.005
"""m: least spread of the ranges that a stuck module should have read. Depth cameras see a plane this uneven."""
_CONE_MARGIN = 1.5
"""By which factor a cone that reads its nearest point may be wider than stated."""
_MIN_NOISE = 0.010
"""m: no module for ranges of centimetres to decimetres is so noisy."""
_MIN_NOISE_RATIO = 8.0
"""The same in multiples of the stated standard deviation, which is seldom wrong by more than a factor of 2 or 3."""
_MAX_CURVATURE = 0.005
"""m: largest second difference of the expected ranges at three successive samples over a smooth surface."""
_SECOND_DIFFERENCE_STD = np.sqrt(6.0)
"""Standard deviation of x - 2 y + z for independent ones."""
_MAD = 1.4826
"""Standard deviations of a normal distribution in its median absolute deviation."""
_UNIT_FACTORS = (0.001, 0.01, 0.1, 10.0, 100.0, 1000.0)
"""Conversion factors of readings in wrong units."""
_MAX_LOG_FACTOR = np.log(2.5)
"""Log factor by which a range may differ from the expected one in the right unit; a unit is wrong by 10 or more."""
_MAX_CODES = 2
"""Number of values that a sensor may use for "no target", as the VL53L0X does 8190 and 8191."""
_MAX_OFFSET = 0.02
"""m that a constant reading may differ from the expected range, besides the pose uncertainty: a module with a large
offset is not stuck."""
_MAX_PROBABILITY = 0.02
"""Probability under the present estimate up to which a pose error is rejected as the explanation."""
_MIN_EXPECTED_RETURNS = 20
"""Least expected returns of a module that is diagnosed as dead: dark or steep places absorb some of them, not all."""
_SIGMAS = 3.0
"""Standard deviations of a range by which the surface must be within range for a return to be certain."""
_MAX_OWN_RANGE, _MAX_OWN_SPREAD = 0.06, 1.5
"""m: parts of the robot that move along with the module are this near; and how much their range may vary, in standard
deviations of the sensor."""
_MIN_PATH = 0.03
"""m: least extent of a path along which the range of anything else changes."""
_MAX_DESCRIBED = 3
"""Modules that a summary describes one by one."""


class Fault(StrEnum):
    STUCK = "stuck"
    ROBOT = "robot"
    NOISE = "noise"
    UNIT = "unit"
    DEAD = "dead"


class Diagnosis(NamedTuple):
    """A module's fault: `text` is a sentence with the numbers and, where it is known, the remedy."""

    module: int
    fault: Fault
    text: str


class _Readings(NamedTuple):
    """One module's samples in a scan, and the ranges that it should have read.

    Attributes:
        name: how a sentence names the module.
        values: (n,), m, as reported; NaN where none was reported.
        returned: (n,): the value is within the sensor's range.
        origins, directions: (n, 3), in base, m and unit.
        expected: (n,), m.
        known: (n,): the surface at that sample is known.
        suspect: no module measured anything in the previous scan.
        missed: the samples as beams, and those of all earlier scans if none of them has returned.
    """

    name: str
    values: Array
    returned: NDArray[np.bool_]
    origins: Array
    directions: Array
    expected: Array
    known: NDArray[np.bool_]
    suspect: bool
    missed: Scan


def diagnose(
    samples: RangeSamples, sensor: Sensor, scene: Scene, estimate: Estimate, before: Sequence[Scan] = ()
) -> tuple[Diagnosis, ...]:
    """The faulty modules of a scan; the others are to be trusted.

    Args:
        samples: the scan as it was sent; modules that the sensor does not have are ignored.
        scene, estimate: as before the scan.
        before: the earlier scans, without the samples of faulty modules.
    """
    modules = [k for k in np.unique(samples.module).tolist() if k < len(sensor.tip_T_module)]
    if not modules:
        return ()
    surface = Surface.from_estimate(scene, estimate)
    earlier = Scan.concatenate(list(before))
    diagnoses = []
    for module in modules:
        readings = _collect_readings(samples, sensor, surface, module, bool(estimate.sensor_problem), earlier)
        for fault, check in _CHECKS.items():
            if text := check(readings, sensor, surface):
                diagnoses.append(Diagnosis(module, fault, f"{readings.name} {text}"))
                break
    return tuple(diagnoses)


def drop_modules(samples: RangeSamples, modules: Collection[int]) -> RangeSamples:
    """The samples without those of `modules`."""
    if not modules:
        return samples
    return samples.select(~np.isin(samples.module, list(modules)))


def summarize(diagnoses: Sequence[Diagnosis]) -> str:
    """What is wrong with a scan's faulty modules, in a few sentences."""
    texts = [diagnosis.text for diagnosis in diagnoses[:_MAX_DESCRIBED]]
    if len(diagnoses) > _MAX_DESCRIBED:
        texts.append(f"{len(diagnoses) - _MAX_DESCRIBED} more modules measure nothing either.")
    return " ".join(texts)


def _collect_readings(
    samples: RangeSamples, sensor: Sensor, surface: Surface, module: int, suspect: bool, earlier: Scan
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
        surface.predict_ranges(origins, directions),
        surface.is_known_at(origins, directions),
        suspect=suspect,
        missed=beams if earlier.returned.any() else Scan.concatenate([earlier, beams]),
    )


def _check_unit(readings: _Readings, sensor: Sensor, _: Surface) -> str:
    """Readings outside the sensor's range that match the expected ranges once multiplied by a power of ten."""
    reported = np.isfinite(readings.values) & (readings.values > 0)
    off = reported & ~readings.returned
    compared = off & readings.known & (readings.expected > 0)
    if compared.sum() < _MIN_UNIT_SAMPLES or 2 * off.sum() <= reported.sum():
        return ""
    values, expected = readings.values[compared], readings.expected[compared]
    if len(np.unique(values)) <= _MAX_CODES:
        return ""
    median = float(np.median(values))
    for factor in _UNIT_FACTORS:
        scaled = factor * values
        inside = (scaled >= sensor.range_min) & (scaled <= sensor.range_max)
        if 2 * inside.sum() > len(values) and np.median(np.abs(np.log(scaled / expected))) <= _MAX_LOG_FACTOR:
            change = f"divided by {1 / factor:.0f}" if factor < 1 else f"multiplied by {factor:.0f}"
            return (
                f"reads {median:.4g} m where {np.median(expected):.3f} m are expected (medians of {len(values)} "
                f"samples); {change} its ranges fit: send metres."
            )
    return ""


def _check_dead(readings: _Readings, sensor: Sensor, surface: Surface) -> str:
    """No return at all, although some of the surface is almost certainly within range."""
    origins, directions = readings.missed.origins, readings.missed.directions
    n = len(origins)
    if n < _MIN_SAMPLES or readings.returned.any():
        return ""
    some = _subsample(n)
    furthest = sensor.range_max - _SIGMAS * sensor.range_std
    within = surface.sample_ranges(origins[some], directions[some]) <= furthest
    count = float(np.quantile(within.mean(axis=1), _MAX_PROBABILITY, method="lower")) * n
    if count < _MIN_EXPECTED_RETURNS:
        return ""
    values = readings.values[np.isfinite(readings.values)]
    reads = "gives no range" if len(values) == 0 else f"gives no range but {np.median(values):.4g} m"
    return (
        f"{reads} in any of {n} samples, although the surface is within {1000 * sensor.range_max:g} mm in at least "
        f"{count:.0f} of them with {1 - _MAX_PROBABILITY:.0%} probability: it is dead, or cannot see this material."
    )


def _check_stuck(readings: _Readings, sensor: Sensor, surface: Surface) -> str:
    """A constant range over a surface whose distance must vary, or after a scan that measured nothing."""
    reported = np.flatnonzero(np.isfinite(readings.values))
    if len(reported) < max(_MIN_SAMPLES, _MIN_REPORTED * len(readings.values)):
        return ""
    constant, spread = _find_narrowest_interval(readings.values[reported])
    if spread > _MAX_STUCK_SPREAD:
        return ""
    count = int((np.abs(readings.values[reported] - constant) <= _MAX_STUCK_SPREAD).sum())
    reads = f"reads {1000 * constant:.1f} mm in {count} of {len(reported)} samples"
    if readings.suspect:
        return f"{reads} after a scan that measured nothing either: it is stuck."
    chosen = reported[readings.known[reported]]
    if len(chosen) < _MIN_SAMPLES:
        return ""
    some = chosen[_subsample(len(chosen))]
    variation, off = _compare_with_constant(readings, some, sensor, surface, constant)
    if ((variation <= _MIN_EXPECTED_SPREAD) & (off <= _MAX_OFFSET)).any(axis=0).mean() > _MAX_PROBABILITY:
        return ""
    low, middle, high = np.quantile(readings.expected[some], (0.1, 0.5, 0.9))
    does = f"varies by {1000 * (high - low):.0f} mm"
    if high - low <= _MIN_EXPECTED_SPREAD:
        does = f"is {1000 * middle:.0f} mm away"
    return f"{reads} while the surface that the camera saw under it {does}: it is stuck."


def _check_robot(readings: _Readings, sensor: Sensor, surface: Surface) -> str:
    """A range that hardly varies along the path, at a place where nothing that the camera saw can be."""
    returned = np.flatnonzero(readings.returned)
    if len(returned) < max(_MIN_SAMPLES, _MIN_REPORTED * len(readings.values)):
        return ""
    middle = float(np.median(readings.values[returned]))
    spread = _MAD * float(np.median(np.abs(readings.values[returned] - middle)))
    if middle > _MAX_OWN_RANGE or spread > max(_MAX_OWN_SPREAD * sensor.range_std, _MAX_STUCK_SPREAD):
        return ""
    chosen = returned[readings.known[returned]]
    if len(chosen) < _MIN_SAMPLES or np.linalg.norm(np.ptp(readings.origins[chosen], axis=0)) < _MIN_PATH:
        return ""
    some = chosen[_subsample(len(chosen))]
    sampled = surface.sample_ranges(readings.origins[some], readings.directions[some])
    explained = (sampled <= middle + _MAX_OFFSET).mean(axis=1)
    if np.quantile(explained, 1 - _MAX_PROBABILITY) > 0.5:
        return ""
    return (
        f"reads {1000 * middle:.0f} mm, give or take {1000 * spread:.1f} mm, in {len(returned)} of "
        f"{len(readings.values)} samples however the tip moves, where nothing that the camera saw is as near: it looks "
        "at the robot itself, such as its other finger. Leave it out of sensor.tip_T_module, or send null."
    )


def _check_noise(readings: _Readings, sensor: Sensor, _: Surface) -> str:
    """Ranges that jump from sample to sample over a smooth surface."""
    kept, expected = readings.returned & readings.known, readings.expected
    in_a_row = kept[:-2] & kept[1:-1] & kept[2:]
    smooth = in_a_row & (np.abs(np.diff(expected, 2)) <= _MAX_CURVATURE)
    if smooth.sum() < _MIN_SAMPLES:
        return ""
    jumps = np.diff(readings.values, 2)[smooth]
    noise = float(_MAD * np.median(np.abs(jumps)) / _SECOND_DIFFERENCE_STD)
    if noise < max(_MIN_NOISE, _MIN_NOISE_RATIO * sensor.range_std):
        return ""
    return (
        f"varies by {1000 * noise:.0f} mm from one sample to the next over a smooth surface ({smooth.sum()} places), "
        f"but the stated standard deviation is {1000 * sensor.range_std:.2g} mm: this is noise."
    )


_CHECKS = {
    Fault.UNIT: _check_unit,
    Fault.DEAD: _check_dead,
    Fault.STUCK: _check_stuck,
    Fault.ROBOT: _check_robot,
    Fault.NOISE: _check_noise,
}


def _find_narrowest_interval(values: Array) -> tuple[float, float]:
    """Median and width, m, of the narrowest interval that holds all of values (n,) but the allowed outliers."""
    ordered = np.sort(values)
    held = len(values) - int(_MAX_OUTLIERS * len(values))
    widths = ordered[held - 1 :] - ordered[: len(values) - held + 1]
    first = int(np.argmin(widths))
    return float(np.median(ordered[first : first + held])), float(widths[first])


def _compare_with_constant(
    readings: _Readings, chosen: NDArray[np.intp], sensor: Sensor, surface: Surface, constant: float
) -> tuple[Array, Array]:
    """How far the ranges expected at the `chosen` samples are from a constant range, m.

    A constant at the end of the sensor's range or beyond may be how it reports that nothing is within range.

    Returns:
        The spread of the ranges, and the distance of their median from the constant, each (c, k), m: for a thin beam
        and, if the sensor has a cone, for one that reads its nearest point; for each sample of the surface's pose.
    """
    origins, directions = readings.origins[chosen], readings.directions[chosen]
    surfaces = [surface]
    if sensor.beam_half_angle > 0:
        distance = min(float(np.median(readings.expected[chosen])), sensor.range_max)
        surfaces.append(surface.dilate(distance * float(np.tan(_CONE_MARGIN * sensor.beam_half_angle))))
    sampled = np.stack([candidate.sample_ranges(origins, directions) for candidate in surfaces])
    if constant >= sensor.range_max - _MAX_STUCK_SPREAD:
        sampled = np.where(sampled >= sensor.range_max, constant, sampled)
    low, middle, high = np.quantile(sampled, (0.1, 0.5, 0.9), axis=-1)
    return high - low, np.abs(middle - constant)


def _subsample(count: int) -> NDArray[np.intp]:
    """The indices of those of `count` samples that are compared."""
    return np.unique(np.linspace(0, count - 1, min(count, _MAX_COMPARED)).astype(np.intp))
