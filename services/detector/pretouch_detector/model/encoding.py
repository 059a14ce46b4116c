"""What the network sees of a scene: a square around the object, its pixels as points in the table's frame.

A finger that comes from above measures heights over the table; the channels hold these instead of depths along the
camera's axis. The square is sampled to a fixed size; rectangles are given in units of the square.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pretouch.geometry import Array
from pretouch.scene import Scene

SIZE = 128
"""Pixels of the square's side."""
CHANNELS = ("height", "away", "across", "object", "seen", "size")
"""Height over the table, and place along and across the camera's view from the object's centroid, all in LENGTH, 0
where there is no depth; 1 on the object; 1 where there is depth; log of the half side in SCALE, everywhere the same."""
LENGTH = 0.05
SCALE = 0.08
_SIDE = 1.5
"""The square's side over the longer side of the object's bounding box: candidates reach beyond the object."""
_LIMIT = 4.0
_MAX_MEDIAN = 16
"""px: side of the largest square over which a median is taken."""


@dataclass(frozen=True, eq=False)
class Encoding:
    """A scene as the network sees it.

    Attributes:
        image: (len(CHANNELS), SIZE, SIZE) float32.
        centre, half: px, the square's middle (u, v) and half its side, in the scene's image.
    """

    image: NDArray[np.float32]
    centre: tuple[float, float]
    half: float

    def normalise(self, rectangles: ArrayLike) -> NDArray[np.float32]:
        """Rectangles (n, 5), px and rad, in units of the square: its sides are at -1 and 1."""
        given = np.asarray(rectangles, dtype=np.float64).reshape(-1, 5)
        return np.column_stack(
            [(given[:, :2] - self.centre) / self.half, given[:, 2:4] / self.half, given[:, 4]]
        ).astype(np.float32)


def encode(scene: Scene) -> Encoding:
    """The scene's square; pixels outside the image count as without depth."""
    u0, v0, u1, v1 = scene.bounds()
    centre = (0.5 * (u0 + u1 - 1), 0.5 * (v0 + v1 - 1))
    half = 0.5 * _SIDE * max(u1 - u0, v1 - v0)
    steps = (np.arange(SIZE) + 0.5) / SIZE * 2.0 - 1.0
    u, v = np.rint(centre[0] + half * steps).astype(np.intp), np.rint(centre[1] + half * steps).astype(np.intp)
    h, w = scene.mask.shape
    inside = ((v >= 0) & (v < h))[:, None] & ((u >= 0) & (u < w))
    window = np.ix_(v.clip(0, h - 1), u.clip(0, w - 1))
    metres = np.where(inside, _sample_depths(scene.depth.metres, window, half), 0.0)
    on = scene.mask[window] & inside & (metres > 0)
    camera = scene.camera
    rays = np.stack(
        np.broadcast_arrays((u - camera.cx) / camera.fx, ((v - camera.cy) / camera.fy)[:, None], 1.0), axis=-1
    )
    arms = scene.base_T_camera.apply(rays * metres[..., None]) - scene.centroid
    away = scene.base_T_camera.rotation[:, 2] - scene.table.normal * (
        scene.base_T_camera.rotation[:, 2] @ scene.table.normal
    )
    away = _normalise(away, scene.base_T_camera.rotation[:, 1])
    across = np.cross(scene.table.normal, away)
    seen = metres > 0
    places = np.stack([scene.table.height(arms + scene.centroid), arms @ away, arms @ across]) / LENGTH
    places = np.where(seen, places.clip(-_LIMIT, _LIMIT), 0.0)
    metres_half = half * float(np.median(scene.depth.metres[scene.mask])) / camera.fx
    size = np.full((1, SIZE, SIZE), np.log(metres_half / SCALE))
    image = np.concatenate([places, on[None], seen[None], size]).astype(np.float32)
    return Encoding(image, centre, half)


def _sample_depths(metres: NDArray[np.float32], window: tuple[NDArray[np.intp], ...], half: float) -> Array:
    """Depths at the window's pixels; where these are 2 px or more apart, the median around each."""
    step = min(int(2 * half / SIZE), _MAX_MEDIAN)
    if step < 2:
        return np.asarray(metres[window], dtype=np.float64)
    rows, columns = (np.ravel(axis) for axis in window)
    padded = np.pad(metres, (step // 2, step - 1 - step // 2), mode="symmetric")
    around = np.arange(step)
    patches = padded[np.add.outer(rows, around)[:, None, :, None], np.add.outer(columns, around)[None, :, None, :]]
    middle = step * step // 2
    ordered = np.partition(patches.reshape(len(rows), len(columns), step * step), middle, axis=-1)
    return ordered[..., middle].astype(np.float64)


def _normalise(vector: Array, otherwise: Array) -> Array:
    length = float(np.linalg.norm(vector))
    return np.asarray(vector / length if length > 1e-6 else otherwise, dtype=np.float64)
