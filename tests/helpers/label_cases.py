"""A small labelled view, made without rendering."""

from __future__ import annotations

import numpy as np
from pretouch_detector.training.dataset import Example

from pretouch.camera import Camera, DepthImage
from pretouch.geometry import Plane, Pose
from pretouch.scene import Scene
from pretouch.tof import Sensor

SENSOR = Sensor(0.02, 0.09, 0.002, 0.15)


def scene(height: int = 20, width: int = 24) -> Scene:
    """A box of 10 x 10 pixels, 5 cm above a table that the camera looks down on from 80 cm."""
    depth = np.full((height, width), 0.8, np.float32)
    depth[5:15, 6:16] = 0.75
    base_T_camera = Pose.of(np.diag([1.0, -1.0, -1.0]), np.array([0.5, 0.0, 0.8]))
    camera = Camera(50.0, 50.0, (width - 1) / 2, (height - 1) / 2)
    return Scene(DepthImage(depth), camera, base_T_camera, depth < 0.78, Plane(np.array([0.0, 0.0, 1.0]), 0.0))


def example(name: str = "box-0-0", rectangles: int = 6, trials: int = 2, seen: Scene | None = None) -> Example:
    """Rectangles with made-up errors, the first half without trials."""
    rng = np.random.default_rng(len(name))
    boxes = rng.uniform([5, 5, 3, 3, -1.5], [15, 15, 9, 9, 1.5], (rectangles, 5)).astype(np.float32).astype(np.float64)
    scores = rng.uniform(0.001, 0.03, (rectangles, trials)).astype(np.float32).astype(np.float64)
    scores[: rectangles // 2] = np.nan
    predicted = rng.uniform(0.002, 0.015, rectangles).astype(np.float32).astype(np.float64)
    return Example(
        name, name.partition("-")[0], seen or scene(), SENSOR, boxes, scores, scores / 2, predicted, {"view": 0}
    )
