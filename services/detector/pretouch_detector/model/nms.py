"""Non-maximum suppression of rotated rectangles, in numpy: all pairs that may overlap too much are computed at once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pretouch_detector.model.rotated_overlap import intersection


def suppressed(rectangles: NDArray[Any], limit: float, count: int) -> NDArray[np.intp]:
    """Picks from the first on, and none that overlaps a picked one by more than `limit`.

    Args:
        rectangles: (n, 5) as [x, y, w, h, theta], the best first.
        limit: intersection over union, exact; greater than 0.
        count: the most that are wanted.

    Returns:
        (k,), k <= count: indices of those picked, increasing.
    """
    area = rectangles[:, 2] * rectangles[:, 3]
    better, worse = np.triu_indices(len(rectangles), 1)
    apart = ((rectangles[better, :2] - rectangles[worse, :2]) ** 2).sum(axis=1)
    reach = np.hypot(rectangles[:, 2], rectangles[:, 3]) / 2
    smaller, larger = np.minimum(area[better], area[worse]), np.maximum(area[better], area[worse])
    near = (apart < (reach[better] + reach[worse]) ** 2) & (smaller >= limit * larger * (1 - 1e-9))
    better, worse = better[near], worse[near]
    common = intersection(rectangles[better], rectangles[worse])
    too_much = np.zeros((len(rectangles), len(rectangles)), dtype=bool)
    too_much[better, worse] = common > limit * (area[better] + area[worse] - common)
    left = np.ones(len(rectangles), dtype=bool)
    picked: list[int] = []
    for index in range(len(rectangles)):
        if left[index] and len(picked) < count:
            picked.append(index)
            left &= ~too_much[index]
    return np.array(picked, dtype=np.intp)
