"""Augmentation: views changed in ways that leave each rectangle's error as it is."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from pretouch_detector.model.encoding import CHANNELS, LENGTH, SIZE
from pretouch_detector.training.targets import Floats, Targets

_HEIGHT, _AWAY, _ACROSS, _OBJECT, _SEEN, _SIZE = range(len(CHANNELS))
_ROLL = np.radians(20.0)
_ZOOM = 0.2
_NOISE = 0.001
"""m, of heights, besides the camera's."""
_HOLES = 3
_HOLE_PX = 14
_EDGE_DROPOUT = 0.3
"""Up to this share of the pixels at the object's outline lose their depth."""


def augment(targets: Targets, rng: np.random.Generator) -> Targets:
    """The view mirrored, rolled about the optical axis, nearer or further, with more noise and holes.

    A mirrored world is as plausible as the original; heights and places depend neither on the camera's roll nor on the
    size of the square.
    """
    mirror = rng.random() < 0.5
    turn, zoom = rng.uniform(-_ROLL, _ROLL), np.exp(rng.uniform(-_ZOOM, _ZOOM))
    shift = rng.uniform(-0.1, 0.1, 2)
    image = _add_noise(_warp(targets.image, turn, zoom, shift), rng)
    x, y, w, h, theta = targets.rectangles.astype(np.float64).T
    cos, sin = np.cos(turn), np.sin(turn)
    x, y = zoom * (cos * x - sin * y) + shift[0], zoom * (sin * x + cos * y) + shift[1]
    theta = theta + turn
    if mirror:
        image = np.ascontiguousarray(image[:, :, ::-1])
        image[_ACROSS] *= -1
        x, theta = -x, -theta
    rectangles = np.column_stack([x, y, zoom * w, zoom * h, theta]).astype(np.float32)
    return Targets(image, rectangles, targets.analytic, targets.errors)


def _warp(image: Floats, turn: float, zoom: float, shift: np.ndarray) -> Floats:
    """The image with each point p at zoom R(turn) p + shift, in the square's units; nearest pixels keep edges sharp."""
    steps = (np.arange(SIZE) + 0.5) / SIZE * 2.0 - 1.0
    x, y = steps[None] - shift[0], steps[:, None] - shift[1]
    cos, sin = np.cos(turn), np.sin(turn)
    u, v = (cos * x + sin * y) / zoom, (cos * y - sin * x) / zoom
    column, row = (np.rint((axis + 1.0) * SIZE / 2.0 - 0.5).astype(np.intp) for axis in (u, v))
    inside = (column >= 0) & (column < SIZE) & (row >= 0) & (row < SIZE)
    moved = np.where(inside, image[:, row.clip(0, SIZE - 1), column.clip(0, SIZE - 1)], np.float32(0.0))
    moved[_SIZE] = image[_SIZE, 0, 0] - np.log(zoom)
    return np.asarray(moved, dtype=np.float32)


def _add_noise(image: Floats, rng: np.random.Generator) -> Floats:
    seen, on = image[_SEEN] > 0, image[_OBJECT] > 0
    rim = on & ~ndimage.binary_erosion(on, iterations=2)
    lost = rim & (rng.random(on.shape) < rng.uniform(0.0, _EDGE_DROPOUT))
    for _ in range(rng.integers(0, _HOLES + 1)):
        v, u = rng.integers(0, SIZE, 2)
        h, w = rng.integers(2, _HOLE_PX, 2)
        lost[v : v + h, u : u + w] = True
    if (on & ~lost).sum() < on.sum() / 2:
        lost[:] = False
    noise = rng.normal(0.0, rng.uniform(0.0, _NOISE) / LENGTH, (3, SIZE, SIZE)).astype(np.float32)
    image = image.copy()
    image[[_HEIGHT, _AWAY, _ACROSS]] += np.where(seen, noise * np.array([1.0, 0.7, 0.2])[:, None, None], 0.0).astype(
        np.float32
    )
    image[_HEIGHT : _SEEN + 1, lost] = 0.0
    return image
