"""Whether what a robot sends of a scan can have been measured along the planned path: units, axes and times."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pretouch.errors import InvalidInput
from pretouch.geometry import Array, Pose, rotation_from_quaternion
from pretouch.scene import Scene
from pretouch.session import Points, ScanPlan
from pretouch.session_warning import SessionWarning
from pretouch.tof import STATUS_OK, RangeSamples, Sensor
from pretouch.trajectory import Trajectory

_MAX_COMPARED = 200
"""Samples that are compared with the path, evenly spaced."""
_USUAL_DISTANCE, _POSSIBLE_DISTANCE = 0.10, 1.0
"""m in the median from the path: a robot that follows it deviates by less; what is farther was not measured on it."""
_POINT_DISTANCE = 0.25
"""m in the median from the path to the points: the standoff, and what the finger can see beyond it."""
_USUAL_TURN, _POSSIBLE_TURN = np.radians(25.0), np.radians(100.0)
"""rad in the median between the tip's z and the planned beam."""
_MATCHING_TURN = np.radians(5.0)
"""rad: a rotation that is this near to the planned one is the planned one."""
_NOTICED_TURN = np.radians(3.0)
"""rad between the beams from which a rotation in another order matters."""
_OFF_AXIS = 0.002
"""m of a module from the beam of the tip, from which the tip's turn about it matters."""
_MAX_TURN_ABOUT = np.radians(45.0)
"""rad about the beam between the tip and the plan."""
_MAX_RANGE = 10.0
"""m: no sensor in a fingertip measures farther."""
_MIN_SAMPLES, _MAX_CODES = 3, 2
"""Least samples in a wrong unit, and how many values a sensor may use for "no target"."""
_MAX_PACE = 300.0
"""Factor by which the tip's speed may differ from the planned one."""
_MIN_STEP = 1e-4
"""m: shorter steps between samples tell no speed."""
_UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}


def check_samples(samples: RangeSamples, plan: ScanPlan, scene: Scene, sensor: Sensor) -> list[SessionWarning]:
    """What is odd about the samples of a scan, or of a piece of it.

    Raises:
        InvalidInput: they cannot have been measured: ranges in millimetres, tip poses far from path and object, a tip
            that points away, times that contradict the tip's speed.
    """
    if len(samples) == 0:
        return []
    _check_ranges(samples, sensor)
    some = samples.select(np.unique(np.linspace(0, len(samples) - 1, min(len(samples), _MAX_COMPARED)).astype(np.intp)))
    tips = some.base_T_tip[:, :3, 3]
    warnings = _check_places(tips, plan, scene, "base_T_tip", "The tip", _USUAL_DISTANCE)
    warnings += _check_turns(some.base_T_tip, plan, sensor)
    _check_times(some.t, tips, plan)
    return warnings


def check_points(points: Points, plan: ScanPlan, scene: Scene) -> list[SessionWarning]:
    """What is odd about a scan's points; raises `InvalidInput` if they are far from path and object."""
    return _check_places(points.points, plan, scene, "points", "The points", _POINT_DISTANCE)


def _check_ranges(samples: RangeSamples, sensor: Sensor) -> None:
    ranges = samples.range[(samples.status == STATUS_OK) & np.isfinite(samples.range)]
    if len(ranges) < _MIN_SAMPLES or np.mean(ranges > _MAX_RANGE) < 0.9 or len(np.unique(ranges)) <= _MAX_CODES:
        return
    median = float(np.median(ranges))
    if not sensor.range_min / 2 <= median / 1000 <= 2 * sensor.range_max:
        return
    raise InvalidInput(
        f"The ranges look like millimetres: {len(ranges)} of them are {median:.4g} m in the median.",
        "Send ranges in metres; null, or a status other than 0, where the sensor saw nothing.",
    )


def _check_places(
    places: Array, plan: ScanPlan, scene: Scene, name: str, subject: str, usual: float
) -> list[SessionWarning]:
    """Whether `places` (n, 3), m, in base, are near the path or the object."""
    off = _measure_distance(places, plan.path)
    if off <= usual:
        return []
    said = f"In {plan.scan_id}: {subject} is {off:.3g} m from the planned path, in the median."
    if off > _POSSIBLE_DISTANCE and _measure_distance(places / 1000, plan.path) <= usual:
        raise InvalidInput(f"{said} In millimetres it would be on it.", f"Send {name} in metres.")
    to_object = float(np.median(np.linalg.norm(places - scene.centroid, axis=1)))
    if min(off, to_object) > _POSSIBLE_DISTANCE:
        raise InvalidInput(
            f"{said} From the object it is {to_object:.3g} m.",
            f"Send {name} in metres, in the base of base_T_camera, and those of this scan; or skip the scan.",
        )
    return [
        SessionWarning(
            f"{name.replace('_', '-').lower()}-off-path",
            said,
            f"Check that {name} is in base, is that of the sensor and not of the flange, and belongs to this scan.",
        )
    ]


def _measure_distance(places: Array, path: Trajectory) -> float:
    """m: the median distance of `places` (n, 3) from the path."""
    corners = path.base_T_tip[:, :3, 3]
    starts, ways = (corners, np.zeros_like(corners)) if len(corners) == 1 else (corners[:-1], np.diff(corners, axis=0))
    lengths = np.maximum((ways**2).sum(axis=1), 1e-18)
    away = places[:, None] - starts
    share = np.clip((away * ways).sum(axis=2) / lengths, 0, 1)
    return float(np.median(np.linalg.norm(away - share[..., None] * ways, axis=2).min(axis=1)))


def _check_turns(poses: Array, plan: ScanPlan, sensor: Sensor) -> list[SessionWarning]:
    """Whether the tips (n, 4, 4) are turned as planned, about the beam too where the sensor's modules are beside it."""
    planned = plan.path.base_T_tip[_find_nearest(poses[:, :3, 3], plan.path), :3, :3]
    turns = poses[:, :3, :3]
    beam = float(np.median(_angles(turns[:, :, 2], planned[:, :, 2])))
    whole = float(np.median(_turns_between(turns, planned)))
    degrees = f"In {plan.scan_id}: The tip's z axis is {np.degrees(beam):.0f} degrees from the planned beam"
    reordered = float(np.median(_turns_between(np.stack([_reorder(turn) for turn in turns]), planned)))
    if beam > _NOTICED_TURN and whole > _USUAL_TURN and reordered <= _MATCHING_TURN:
        detail = f"{degrees}; with its quaternion read as w, x, y, z the tip is turned as planned."
        remedy = "Send rotations as x, y, z, w."
        if beam > _POSSIBLE_TURN:
            raise InvalidInput(detail, remedy)
        return [SessionWarning("tip-wxyz", detail, remedy)]
    if beam > _POSSIBLE_TURN:
        raise InvalidInput(
            f"{degrees}: it points away from the object.",
            "Send the sensor's pose with z along its beam, towards what it measures.",
        )
    if beam > _USUAL_TURN:
        return [
            SessionWarning(
                "tip-tilted",
                f"{degrees}, in the median.",
                "Send the sensor's own pose, z along its beam. If the robot had to tilt the finger, this is right.",
            )
        ]
    beside = max(float(np.hypot(*pose.translation[:2])) for pose in sensor.tip_T_module)
    if beside > _OFF_AXIS and whole > _MAX_TURN_ABOUT:
        return [
            SessionWarning(
                "tip-turned",
                f"In {plan.scan_id}: The tip is turned by {np.degrees(whole):.0f} degrees about its beam.",
                "Check the order of the quaternion, x, y, z, w, and the axes of tip_T_module. If the robot turned the "
                "finger, this is right.",
            )
        ]
    return []


def _check_times(t: Array, tips: Array, plan: ScanPlan) -> None:
    """Whether tips (n, 3), m, at times (n,), s, move about as fast as planned, pauses aside."""
    steps, seconds = np.linalg.norm(np.diff(tips, axis=0), axis=1), np.diff(t)
    moving = (steps > _MIN_STEP) & (seconds > 0)
    if moving.sum() < _MIN_SAMPLES or plan.path.duration <= 0 or plan.path.length <= 0:
        return
    speed = float(np.median(steps[moving] / seconds[moving]))
    planned = plan.path.length / plan.path.duration
    if 1 / _MAX_PACE <= speed / planned <= _MAX_PACE:
        return
    likely = [unit for unit, factor in _UNITS.items() if 1 / 30 < speed * factor / planned < 30]
    reading = f" Read in {likely[0]} it would be {speed * _UNITS[likely[0]]:.3g} m/s." if likely else ""
    raise InvalidInput(
        f"By the samples' times the tip moves at {speed:.3g} m/s; {planned:.3g} m/s were planned.{reading}",
        "Send t in seconds.",
    )


def _find_nearest(places: Array, path: Trajectory) -> NDArray[np.intp]:
    """(n,): the waypoint nearest to each of `places` (n, 3)."""
    return np.asarray(np.linalg.norm(places[:, None] - path.base_T_tip[:, :3, 3], axis=2).argmin(axis=1), dtype=np.intp)


def _reorder(rotation: Array) -> Array:
    """The rotation that was meant where its quaternion was sent as w, x, y, z."""
    w, x, y, z = Pose.of(rotation, np.zeros(3)).quaternion
    return rotation_from_quaternion([x, y, z, w])


def _angles(a: Array, b: Array) -> Array:
    """(n,), rad, between unit vectors (n, 3)."""
    return np.asarray(np.arccos(np.clip((a * b).sum(axis=1), -1, 1)), dtype=np.float64)


def _turns_between(a: Array, b: Array) -> Array:
    """(n,), rad, of the rotations that take a to b, each (n, 3, 3)."""
    return np.asarray(np.arccos(np.clip(((a * b).sum(axis=(1, 2)) - 1) / 2, -1, 1)), dtype=np.float64)
