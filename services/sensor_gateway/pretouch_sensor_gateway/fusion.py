"""Ranges and tip poses become samples, each with the tip's pose at its own time, and points in base."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pretouch.errors import InvalidInput
from pretouch.geometry import Array, Pose
from pretouch.tof import MAX_SAMPLES, STATUS_OK, RangeSamples
from pretouch_sensor_gateway.frames import Frames
from pretouch_sensor_gateway.poses import Placing, PosePath

StdAt = Callable[[Array], Array]
"""One standard deviation, m, of ranges (f, k), m, of a device's k modules."""


@dataclass(frozen=True, eq=False)
class Fused:
    """What fusion can say by now of n samples.

    Attributes:
        samples: in the order of time.
        origins: (n, 3) m in base, where each beam starts.
        directions: (n, 3) unit in base, where it points.
        points: (n, 3) m in base, where it came back from; NaN where it did not.
        std: (n,) m, one standard deviation of the point: the range's noise along the beam, and the way that the point
            moves within one standard deviation of the sample's time; NaN where there is no point.
        flags: (n,) uint8, of `batch.Flag`.
        unposed: frames given up since the last time, because no two poses close enough enclose them.
    """

    samples: RangeSamples
    origins: Array
    directions: Array
    points: Array
    std: Array
    flags: NDArray[np.uint8]
    unposed: int


class Fusion:
    """Fuses one listener's frames with the poses on `path`, which others append to.

    Frames wait for poses as late as themselves, at most as many as make `MAX_SAMPLES` samples; then the oldest go.

    Args:
        tip_T_module: pose of each module in the tip frame.
        std_at: how sure the device's ranges are.
    """

    def __init__(self, path: PosePath, tip_T_module: Sequence[Pose], std_at: StdAt) -> None:
        self._path = path
        self._tip_T_module = np.stack([pose.matrix for pose in tip_T_module])
        self._std_at = std_at
        self._waiting = Frames.none()
        self._unposed = 0
        self._newest = -np.inf

    def add(self, frames: Frames) -> None:
        """Takes in new frames. Those that still wait of a device with another number of modules are given up.

        Raises:
            InvalidInput: they have more modules than were described.
        """
        if frames.modules > len(self._tip_T_module):
            raise InvalidInput(
                f"The device has {frames.modules} modules; tip_t_module describes {len(self._tip_T_module)}.",
                "Send the pose of each module in the first message, or configure them in the gateway.",
            )
        if frames.modules == self._waiting.modules:
            frames = Frames.concatenate([self._waiting, frames])
        else:
            self._unposed += len(self._waiting)
        excess = max(0, len(frames) - MAX_SAMPLES // frames.modules)
        self._unposed += excess
        self._waiting = frames.select(slice(excess, None))
        self._newest = max(self._newest, float(frames.t.max()))

    def take(self) -> Fused:
        """All that can be fused with the poses known by now; what is newer than the newest pose waits."""
        placing = [self._path.placing(t) for t in self._waiting.t.tolist()]
        known = np.array([place is Placing.KNOWN for place in placing], dtype=bool)
        later = np.array([place is Placing.LATER for place in placing], dtype=bool)
        unposed = self._unposed + int(np.count_nonzero(~known & ~later))
        ready, self._waiting, self._unposed = self._waiting.select(known), self._waiting.select(later), 0
        return self._fused(ready, unposed)

    @property
    def complete(self) -> bool:
        """Whether frames have come that are newer than the newest pose: without more poses, nothing will follow."""
        return self._path.end is None or self._newest > self._path.end

    def _fused(self, frames: Frames, unposed: int) -> Fused:
        frames = frames.select(np.argsort(frames.t, kind="stable"))
        samples = _samples(frames, self._path)
        modules = self._tip_T_module[: frames.modules]
        base_T_module = (samples.base_T_tip @ modules[samples.module]) if len(samples) else np.zeros((0, 4, 4))
        origins, directions = base_T_module[:, :3, 3], base_T_module[:, :3, 2]
        ranges = np.where(samples.status == STATUS_OK, samples.range, np.nan)
        noise = self._std_at(frames.range).ravel()
        moved = _speed(frames, ranges, modules, self._path) * np.repeat(frames.time_std, frames.modules)
        return Fused(
            samples=samples,
            origins=origins,
            directions=directions,
            points=origins + ranges[:, None] * directions,
            std=np.where(np.isfinite(ranges), np.hypot(noise, moved), np.nan),
            flags=frames.flags.ravel(),
            unposed=unposed,
        )


def fuse_span(frames: Frames, paths: Sequence[PosePath]) -> RangeSamples:
    """Samples of all frames that one of `paths` places, in the order of time; the first path that does counts.

    Raises:
        TooLarge: more samples than a scan may have.
    """
    parts = []
    for path in paths:
        known = np.array([path.placing(t) is Placing.KNOWN for t in frames.t.tolist()], dtype=bool)
        parts.append(_samples(frames.select(known), path))
        frames = frames.select(~known)
    return _in_order(parts)


def _samples(frames: Frames, path: PosePath) -> RangeSamples:
    """One sample for each module of each frame, each of which the path places."""
    poses = path.at(frames.t.tolist()) if len(frames) else np.zeros((0, 4, 4))
    return RangeSamples(
        t=np.repeat(frames.t, frames.modules),
        base_T_tip=np.repeat(poses, frames.modules, axis=0),
        range=frames.range.ravel(),
        status=frames.status.ravel().astype(np.int64),
        module=np.tile(np.arange(frames.modules), len(frames)),
    )


def _in_order(parts: Sequence[RangeSamples]) -> RangeSamples:
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


def _speed(frames: Frames, ranges: Array, modules: Array, path: PosePath) -> Array:
    """(n,) m/s at which each sample's point would move if the tip went on and the range stayed; NaN: a miss.

    The point is carried by the whole motion, so that a turning finger's lever counts.
    """
    if not len(frames):
        return np.zeros(0)
    before, after, seconds = path.segments(frames.t.tolist())
    tips = np.stack([modules[:, :3, 3], modules[:, :3, 2]])  # origin and direction in the tip frame
    in_tip = tips[0] + ranges.reshape(len(frames), -1)[..., None] * tips[1]
    change = after - before
    moved = np.einsum("fij,fkj->fki", change[:, :3, :3], in_tip) + change[:, None, :3, 3]
    return np.asarray(np.linalg.norm(moved, axis=2) / seconds[:, None]).ravel()
