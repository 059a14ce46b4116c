"""Fuses ranges with tip poses: samples with the tip's pose at the time of each, and points in base."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pretouch.errors import InvalidInput
from pretouch.geometry import Array, Pose
from pretouch.tof import MAX_SAMPLES, STATUS_OK, RangeSamples
from pretouch_sensor_gateway.measurements import Measurements
from pretouch_sensor_gateway.pose_path import PoseAvailability, PosePath


@dataclass(frozen=True, eq=False)
class FusedSamples:
    """n fused samples.

    Attributes:
        samples: in the order of time.
        origins: (n, 3) m in base, where each beam starts.
        directions: (n, 3) unit in base, where it points.
        points: (n, 3) m in base, where it was reflected; NaN for a miss.
        std: (n,) m, one standard deviation of the point: the range's noise along the beam, and the way that the point
            moves within one standard deviation of the sample's time; NaN where there is no point, or the noise is not
            known.
        flags: (n,) uint8, of `range_batch.Flag`.
        unposed: measurements dropped since the last call, because no two poses close enough enclose them.
    """

    samples: RangeSamples
    origins: Array
    directions: Array
    points: Array
    std: Array
    flags: NDArray[np.uint8]
    unposed: int


class Fusion:
    """Fuses one subscriber's measurements with the poses on `path`, to which the caller appends.

    Measurements wait until a pose at least as late has arrived. At most `MAX_SAMPLES` samples wait; then the oldest go.

    Args:
        tip_T_module: pose of each module in the tip's coordinate frame.
    """

    def __init__(self, path: PosePath, tip_T_module: Sequence[Pose]) -> None:
        self._path = path
        self._tip_T_module = np.stack([pose.matrix for pose in tip_T_module])
        self._pose_time_std = 0.0
        self._waiting = Measurements.empty()
        self._unposed = 0
        self._newest = -np.inf

    def follow(self, path: PosePath, pose_time_std: float) -> None:
        """Takes poses from `path` from now on, also for the measurements that wait.

        Args:
            pose_time_std: one standard deviation of the poses' times, s, common to all.
        """
        self._path, self._pose_time_std = path, pose_time_std

    def add(self, measurements: Measurements) -> None:
        """Adds measurements. If the number of modules changed, those that still wait are dropped.

        Raises:
            InvalidInput: they have more modules than were described.
        """
        if measurements.modules > len(self._tip_T_module):
            raise InvalidInput(
                f"The device has {measurements.modules} modules; tip_t_module describes {len(self._tip_T_module)}.",
                "Send the pose of each module in the first message of StreamPoints, or call Configure once.",
            )
        if measurements.modules == self._waiting.modules:
            measurements = Measurements.concatenate([self._waiting, measurements])
        else:
            self._unposed += len(self._waiting)
        excess = max(0, len(measurements) - MAX_SAMPLES // measurements.modules)
        self._unposed += excess
        self._waiting = measurements.select(slice(excess, None))
        self._newest = max(self._newest, float(measurements.t.max()))

    def take(self) -> FusedSamples:
        """Fuses all measurements whose poses are available; those newer than the newest pose wait."""
        availability = [self._path.availability(t) for t in self._waiting.t.tolist()]
        available = np.array([one is PoseAvailability.AVAILABLE for one in availability], dtype=bool)
        pending = np.array([one is PoseAvailability.PENDING for one in availability], dtype=bool)
        unposed = self._unposed + int(np.count_nonzero(~available & ~pending))
        ready, self._waiting, self._unposed = self._waiting.select(available), self._waiting.select(pending), 0
        return self._fuse(ready, unposed)

    @property
    def complete(self) -> bool:
        """Whether there are measurements newer than the newest pose: without more poses, nothing will follow."""
        return self._path.end is None or self._newest > self._path.end

    def _fuse(self, measurements: Measurements, unposed: int) -> FusedSamples:
        measurements = measurements.select(np.argsort(measurements.t, kind="stable"))
        samples = _samples(measurements, self._path)
        modules = self._tip_T_module[: measurements.modules]
        base_T_module = (samples.base_T_tip @ modules[samples.module]) if len(samples) else np.zeros((0, 4, 4))
        origins, directions = base_T_module[:, :3, 3], base_T_module[:, :3, 2]
        ranges = np.where(samples.status == STATUS_OK, samples.range, np.nan)
        noise = measurements.std.ravel().astype(np.float64)
        time_std = np.repeat(np.hypot(measurements.time_std, self._pose_time_std), measurements.modules)
        moved = _speed(measurements, ranges, modules, self._path) * time_std
        return FusedSamples(
            samples=samples,
            origins=origins,
            directions=directions,
            points=origins + ranges[:, None] * directions,
            std=np.where(np.isfinite(ranges), np.hypot(noise, moved), np.nan),
            flags=measurements.flags.ravel(),
            unposed=unposed,
        )


def fuse_span(measurements: Measurements, paths: Sequence[PosePath]) -> RangeSamples:
    """Samples, in the order of time, of all measurements for which a path has a pose; the first such path counts.

    Raises:
        TooLarge: more samples than a scan may have.
    """
    parts = []
    for path in paths:
        availability = [path.availability(t) for t in measurements.t.tolist()]
        available = np.array([one is PoseAvailability.AVAILABLE for one in availability], dtype=bool)
        parts.append(_samples(measurements.select(available), path))
        measurements = measurements.select(~available)
    return _merge(parts)


def _samples(measurements: Measurements, path: PosePath) -> RangeSamples:
    """One sample for each module of each measurement, all of which have poses on `path`."""
    poses = path.at(measurements.t.tolist()) if len(measurements) else np.zeros((0, 4, 4))
    return RangeSamples(
        t=np.repeat(measurements.t, measurements.modules),
        base_T_tip=np.repeat(poses, measurements.modules, axis=0),
        range=measurements.range.ravel(),
        status=measurements.status.ravel().astype(np.int64),
        module=np.tile(np.arange(measurements.modules), len(measurements)),
    )


def _merge(parts: Sequence[RangeSamples]) -> RangeSamples:
    """All samples in the order of time."""
    if len(parts) == 1:
        return parts[0]
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) if parts else empty
        for name, empty in (
            ("t", np.zeros(0)),
            ("base_T_tip", np.zeros((0, 4, 4))),
            ("range", np.zeros(0)),
            ("status", np.zeros(0, dtype=np.int64)),
            ("module", np.zeros(0, dtype=np.int64)),
        )
    }
    order = np.argsort(columns["t"], kind="stable")
    return RangeSamples(**{name: column[order] for name, column in columns.items()})


def _speed(measurements: Measurements, ranges: Array, modules: Array, path: PosePath) -> Array:
    """(n,) m/s at which each sample's point would move if the tip went on and the range stayed; NaN: a miss.

    The point moves with the whole motion of the tip, so a rotation counts with its lever arm.
    """
    if not len(measurements):
        return np.zeros(0)
    before, after, seconds = path.segments(measurements.t.tolist())
    tips = np.stack([modules[:, :3, 3], modules[:, :3, 2]])  # origin and direction in the tip's coordinate frame
    in_tip = tips[0] + ranges.reshape(len(measurements), -1)[..., None] * tips[1]
    change = after - before
    moved = np.einsum("fij,fkj->fki", change[:, :3, :3], in_tip) + change[:, None, :3, 3]
    return np.asarray(np.linalg.norm(moved, axis=2) / seconds[:, None]).ravel()
