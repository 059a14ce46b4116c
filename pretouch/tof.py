"""The fingertip's time-of-flight sensor: what it is, and what it measured along a scan.

Tip frame: z along the beam. Module k of the finger sits at `tip_T_module[k]`, its own z along its own beam.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pretouch.errors import InvalidInput, Malformed, TooLarge
from pretouch.geometry import MAX_DISTANCE, Array, Pose, check_poses, frozen_array

MAX_SAMPLES = 20_000
MAX_TIME = 1e12
"""s; 30,000 years either way."""
STATUS_OK = 0
_EMPTY_COLUMNS = {"t": (0,), "base_T_tip": (0, 4, 4), "range": (0,), "status": (0,), "module": (0,)}
"""The shapes of the columns of no samples."""


@dataclass(frozen=True)
class Sensor:
    """The fingertip's range sensor.

    Attributes:
        range_min: shortest range along the beam, in metres.
        range_max: longest range along the beam, in metres; beyond it there is no return.
        range_std: standard deviation of one range, in metres.
        beam_half_angle: half angle of the beam's cone, in radians; 0 is a thin beam.
        rate: measurements of each module per second, in hertz.
        tip_T_module: pose of each module in the tip frame, z along its beam; left out: one module at the tip.
        range_bias_std: standard deviation of the error that all ranges of one scan share, in metres.

    Raises:
        Malformed: a value is not finite.
        InvalidInput: a value out of its limits.
    """

    range_min: float = 0.01
    range_max: float = 0.10
    range_std: float = 0.0015
    beam_half_angle: float = 0.0
    rate: float = 30.0
    tip_T_module: tuple[Pose, ...] = field(default_factory=lambda: (Pose.identity(),))
    range_bias_std: float = 0.0007

    def __post_init__(self) -> None:
        for name in ("range_min", "range_max", "range_std", "beam_half_angle", "rate", "range_bias_std"):
            object.__setattr__(self, name, float(frozen_array(getattr(self, name), (), f"sensor.{name}")))
        checks = {
            "range_min": self.range_min >= 0,
            "range_max": self.range_min < self.range_max <= 10,
            "range_std": 0 < self.range_std <= 0.1,
            "beam_half_angle": 0 <= self.beam_half_angle < np.pi / 4,
            "rate": 0 < self.rate <= 10_000,
            "tip_T_module": 1 <= len(self.tip_T_module) <= 256,
            "range_bias_std": 0 <= self.range_bias_std <= 0.1,
        }
        for name, good in checks.items():
            if not good:
                raise InvalidInput(
                    f"sensor.{name} is {getattr(self, name)!r}.",
                    "Need 0 <= range_min < range_max <= 10 m, 0 < range_std <= 0.1 m, 0 <= beam_half_angle < pi/4 rad, "
                    "0 < rate <= 10000 Hz, 1 to 256 modules, 0 <= range_bias_std <= 0.1 m.",
                )

    @property
    def longest_scan(self) -> float:
        """s: the duration of a scan of MAX_SAMPLES samples of all modules."""
        return (MAX_SAMPLES / len(self.tip_T_module) - 1) / self.rate

    @property
    def spot_radius(self) -> float:
        """m: the beam's radius in the middle of the range."""
        return float(0.5 * (self.range_min + self.range_max) * np.tan(self.beam_half_angle))


@dataclass(frozen=True, eq=False)
class RangeSamples:
    """The n samples of one scan, as a robot sends them.

    Attributes:
        t: (n,) times in seconds, non-decreasing, on one clock.
        base_T_tip: (n, 4, 4) poses of the tip in base at the samples' times, translation in metres; the tip frame has z
            along the beam.
        range: (n,) ranges along the beam, in metres; NaN where the sensor returned none.
        status: (n,) the sensor's own status codes; 0 is good.
        module: (n,) indices of the modules in the sensor's `tip_T_module`.

    Raises:
        Malformed, InvalidInput, TooLarge: see the message.
    """

    t: Array
    base_T_tip: Array
    range: Array
    status: NDArray[np.int64]
    module: NDArray[np.int64]

    def __post_init__(self) -> None:
        t = frozen_array(self.t, (None,), "samples.t", MAX_TIME)
        n = len(t)
        if n > MAX_SAMPLES:
            raise TooLarge(f"The scan has {n} samples; the limit is {MAX_SAMPLES}.", "Split or thin out the scan.")
        if (np.diff(t) < 0).any():
            k = int(np.argmax(np.diff(t) < 0))
            raise InvalidInput(
                f"samples[{k + 1}].t is {t[k + 1]:g}, before samples[{k}].t, {t[k]:g}.",
                "Send the samples in the order of time.",
            )
        poses = frozen_array(self.base_T_tip, (n, 4, 4), "samples.base_T_tip", MAX_DISTANCE)
        check_poses(poses, "samples")
        ranges = np.array(self.range, dtype=np.float64)
        if ranges.shape != (n,) or np.isinf(ranges).any():
            raise Malformed("samples.range is not one finite number or null a sample.", "Send null for no return.")
        negative = np.flatnonzero(ranges < 0)
        if len(negative):
            raise InvalidInput(
                f"samples[{negative[0]}].range is {ranges[negative[0]]:g}.",
                "Send ranges in metres along the beam, or null.",
            )
        arrays: dict[str, NDArray[Any]] = {"t": t, "base_T_tip": poses, "range": ranges}
        for name in ("status", "module"):
            codes = np.array(getattr(self, name), dtype=np.int64)
            if codes.shape != (n,) or (codes < 0).any():
                raise InvalidInput(f"samples.{name} is not one non-negative integer a sample.", f"Mend {name}.")
            arrays[name] = codes
        for name, array in arrays.items():
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @staticmethod
    def concatenate(parts: Sequence[RangeSamples]) -> RangeSamples:
        """The samples of all parts, one part after the other; without parts, none.

        Raises:
            InvalidInput: a part begins before the one before it ends.
            TooLarge: more than MAX_SAMPLES.
        """
        return RangeSamples(**_join(parts))

    @staticmethod
    def merge(parts: Sequence[RangeSamples]) -> RangeSamples:
        """The samples of all parts in the order of time; raises `TooLarge`."""
        columns = _join(parts)
        order = np.argsort(columns["t"], kind="stable")
        return RangeSamples(**{name: column[order] for name, column in columns.items()})

    def select(self, index: slice | NDArray[Any]) -> RangeSamples:
        """The samples at `index`, a slice or a mask."""
        return RangeSamples(**{name: column[index] for name, column in _join([self]).items()})

    def __len__(self) -> int:
        return len(self.t)

    def beams(self, sensor: Sensor) -> Scan:
        """The same samples as beams in base: what the registrar matches.

        A range beyond `range_max`, a status other than 0 and a missing range are misses.

        Raises:
            InvalidInput: a module that the sensor does not have, or a good range below `range_min`.
        """
        if len(self) and self.module.max() >= len(sensor.tip_T_module):
            raise InvalidInput(
                f"A sample names module {self.module.max()}; the sensor has {len(sensor.tip_T_module)}.",
                "Give sensor.tip_T_module for each module when the session is created.",
            )
        good = (self.status == STATUS_OK) & np.isfinite(self.range)
        if (good & (self.range < sensor.range_min)).any():
            worst = float(self.range[good].min())
            raise InvalidInput(
                f"A good sample's range is {worst:g} m, below the sensor's range_min of {sensor.range_min:g} m.",
                "Send the sensor's own error status with it, or null, or create the session with the right sensor.",
            )
        modules = np.stack([pose.matrix for pose in sensor.tip_T_module])[self.module]
        base_T_module = self.base_T_tip @ modules
        returned = good & (self.range <= sensor.range_max)
        return Scan(
            origins=base_T_module[:, :3, 3],
            directions=base_T_module[:, :3, 2],
            ranges=np.where(returned, self.range, np.nan),
        )


def _join(parts: Sequence[RangeSamples]) -> dict[str, NDArray[Any]]:
    """The columns of all parts, one part after the other."""
    return {
        name: np.concatenate([np.zeros(shape), *(getattr(part, name) for part in parts)])
        for name, shape in _EMPTY_COLUMNS.items()
    }


@dataclass(frozen=True, eq=False)
class Scan:
    """Range measurements as beams in base: the registrar's and the simulator's view of a scan.

    A point without a beam is a beam of length 0 at the point.

    Attributes:
        origins: (n, 3), m, where each beam starts.
        directions: (n, 3), unit, where it points.
        ranges: (n,), m; NaN is a miss: nothing within the sensor's range.
    """

    origins: Array
    directions: Array
    ranges: Array

    def __post_init__(self) -> None:
        origins = frozen_array(self.origins, (None, 3), "scan origins")
        directions = frozen_array(self.directions, (len(origins), 3), "scan directions")
        if len(origins) and np.abs(np.linalg.norm(directions, axis=1) - 1).max() > 1e-3:
            raise InvalidInput("A beam's direction is not a unit vector.", "Send unit directions.")
        ranges = np.array(self.ranges, dtype=np.float64)
        if ranges.shape != (len(origins),) or np.isinf(ranges).any() or (ranges < 0).any():
            raise Malformed(
                "A range is infinite or negative, or their number is off.", "Send one range a beam; NaN is a miss."
            )
        ranges.setflags(write=False)
        for name, array in {"origins": origins, "directions": directions, "ranges": ranges}.items():
            object.__setattr__(self, name, array)

    @staticmethod
    def of_points(points: ArrayLike, down: ArrayLike) -> Scan:
        """From points (n, 3) in base without beams; `down` (3,) is the direction that their beams are said to have."""
        origins = frozen_array(points, (None, 3), "points")
        if len(origins) > MAX_SAMPLES:
            raise TooLarge(f"The scan has {len(origins)} points; the limit is {MAX_SAMPLES}.", "Thin out the scan.")
        return Scan(origins, np.broadcast_to(np.asarray(down, dtype=np.float64), origins.shape), np.zeros(len(origins)))

    @staticmethod
    def concatenate(scans: list[Scan]) -> Scan:
        if not scans:
            return Scan(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
        return Scan(
            np.concatenate([s.origins for s in scans]),
            np.concatenate([s.directions for s in scans]),
            np.concatenate([s.ranges for s in scans]),
        )

    def __len__(self) -> int:
        return len(self.ranges)

    @property
    def returned(self) -> NDArray[np.bool_]:
        """(n,) True where the beam returned a range."""
        return np.isfinite(self.ranges)

    def points(self) -> Array:
        """(m, 3), m, in base: the returned samples' points."""
        hit = self.returned
        return np.asarray(self.origins[hit] + self.ranges[hit, None] * self.directions[hit], dtype=np.float64)
