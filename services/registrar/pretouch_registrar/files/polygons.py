"""Polygons as triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def fans(counts: NDArray[np.int64], indices: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangles (m, 3) of polygons whose corners, `counts` each, follow each other in `indices`."""
    starts = np.cumsum(counts) - counts
    cuts = np.maximum(counts - 2, 0)
    polygon = np.repeat(np.arange(len(counts)), cuts)
    step = np.arange(len(polygon)) - np.repeat(np.cumsum(cuts) - cuts, cuts)
    first = starts[polygon]
    return np.stack([indices[first], indices[first + step + 1], indices[first + step + 2]], axis=1)
