"""The last ten minutes of one device: its frames, and the tip poses that robots told."""

from __future__ import annotations

from collections import deque

from pretouch_sensor_gateway.poses import PosePath
from pretouch_sensor_gateway.subscription import TimedFrame

SPAN = 600.0
"""Seconds remembered."""
MAX_FRAMES = 120_000
"""Frames remembered: `SPAN` at 200 Hz; of a faster device less time is remembered."""
MAX_PATHS = 16
"""Pose paths remembered, one for each robot's call that told any; the oldest goes."""


class History:
    """What a later question may be about; bounded in time and number."""

    def __init__(self) -> None:
        self._frames: deque[TimedFrame] = deque(maxlen=MAX_FRAMES)
        self._paths: deque[PosePath] = deque(maxlen=MAX_PATHS)

    def add(self, frame: TimedFrame) -> None:
        while self._frames and self._frames[0].t < frame.t - SPAN:
            self._frames.popleft()
        self._frames.append(frame)

    def remember(self, path: PosePath) -> None:
        """Keeps `path`, which may go on growing."""
        self._paths.append(path)

    def between(self, start: float, end: float) -> tuple[list[TimedFrame], list[PosePath]]:
        """Copies of the frames within the span, s since the Unix epoch, and of the paths, the newest first."""
        frames = [frame for frame in self._frames if start <= frame.t <= end]
        return frames, [path.between(start, end) for path in reversed(self._paths)]
