"""Ranges and tip poses become samples, each with the tip's pose at its own time, and points in base."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pretouch.errors import InvalidInput
from pretouch.geometry import Array, Pose
from pretouch.tof import MAX_SAMPLES, STATUS_OK, RangeSamples
from pretouch_sensor_gateway.poses import Placing, PosePath
from pretouch_sensor_gateway.subscription import TimedFrame


@dataclass(frozen=True, eq=False)
class Fused:
    """What fusion can say by now.

    Attributes:
        samples: in the order of time.
        points: (m, 3), m in base, of the samples that came back, in their order.
        unposed: frames given up since the last time, because no two poses close enough enclose them.
    """

    samples: RangeSamples
    points: Array
    unposed: int


class Fusion:
    """Fuses one listener's frames with the poses on `path`, which others append to.

    Frames wait for poses as late as themselves, at most as many as make `MAX_SAMPLES` samples; then the oldest go.

    Args:
        tip_T_module: pose of each module in the tip frame.
    """

    def __init__(self, path: PosePath, tip_T_module: Sequence[Pose]) -> None:
        self._path = path
        self._modules = np.stack([pose.matrix for pose in tip_T_module])
        self._waiting: deque[TimedFrame] = deque()
        self._unposed = 0
        self._newest = -np.inf

    def add(self, frames: Sequence[TimedFrame]) -> None:
        """Takes in new frames.

        Raises:
            InvalidInput: a frame has more modules than were described.
        """
        for frame in frames:
            if len(frame.ranges) > len(self._modules):
                raise InvalidInput(
                    f"The device has {len(frame.ranges)} modules; tip_t_module describes {len(self._modules)}.",
                    "Send the pose of each module in the first message.",
                )
            self._newest = max(self._newest, frame.t)
            self._waiting.append(frame)
        while len(self._waiting) * len(self._modules) > MAX_SAMPLES:
            self._waiting.popleft()
            self._unposed += 1

    def take(self) -> Fused:
        """All that can be fused with the poses known by now; what is newer than the newest pose waits."""
        ready, later = [], []
        for frame in self._waiting:
            placing = self._path.placing(frame.t)
            if placing is Placing.KNOWN:
                ready.append(frame)
            elif placing is Placing.LATER:
                later.append(frame)
            else:
                self._unposed += 1
        self._waiting = deque(later)
        samples = _with_poses(ready, self._path.at([frame.t for frame in ready]) if ready else np.zeros((0, 4, 4)))
        fused = Fused(samples, self._points(samples), self._unposed)
        self._unposed = 0
        return fused

    @property
    def complete(self) -> bool:
        """Whether frames have come that are newer than the newest pose: without more poses, nothing will follow."""
        return self._path.end is None or self._newest > self._path.end

    def _points(self, samples: RangeSamples) -> Array:
        returned = (samples.status == STATUS_OK) & np.isfinite(samples.range)
        base_T_module = samples.base_T_tip[returned] @ self._modules[samples.module[returned]]
        points: Array = base_T_module[:, :3, 3] + samples.range[returned, None] * base_T_module[:, :3, 2]
        return points


def fuse_span(frames: Sequence[TimedFrame], paths: Sequence[PosePath]) -> RangeSamples:
    """Samples of all frames that one of `paths` places; the first path that does counts.

    Raises:
        TooLarge: more samples than a scan may have.
    """
    placed: list[TimedFrame] = []
    poses = [np.zeros((0, 4, 4))]
    remaining = list(frames)
    for path in paths:
        known = [frame for frame in remaining if path.placing(frame.t) is Placing.KNOWN]
        if known:
            remaining = [frame for frame in remaining if path.placing(frame.t) is not Placing.KNOWN]
            placed += known
            poses.append(path.at([frame.t for frame in known]))
    return _with_poses(placed, np.concatenate(poses))


def _with_poses(frames: Sequence[TimedFrame], base_T_tip: Array) -> RangeSamples:
    """One sample for each module of each frame, in the order of time; `base_T_tip` (n, 4, 4) is that of each frame."""
    counts = np.array([len(frame.ranges) for frame in frames], dtype=np.int64)
    t = np.repeat([frame.t for frame in frames], counts)
    order = np.argsort(t, kind="stable")  # a better estimate of the device's clock may step back a little
    return RangeSamples(
        t=t[order],
        base_T_tip=np.repeat(base_T_tip, counts, axis=0)[order],
        range=np.array([metres for frame in frames for metres in frame.ranges])[order],
        status=np.array([code for frame in frames for code in frame.status], dtype=np.int64)[order],
        module=np.array([k for count in counts for k in range(count)], dtype=np.int64)[order],
    )
