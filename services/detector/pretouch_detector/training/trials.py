"""The paper's Algorithm 1: rectangles scored by simulated registrations, without a robot.

After Lancaster, Yang and Smith, "Improved Object Pose Estimation via Deep Pre-touch Sensing", IROS 2017: random
rectangles in the image, random offsets of the camera's cloud, and for each pair a match of the points on the
rectangle's perimeter. The worst trial of a rectangle decides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pretouch_registrar.engines import camera_model
from pretouch_registrar.engines.label_trials import Matching, TrialSettings, View, compute_scores, find_best

from pretouch.geometry import Array, rotation_from_vector, vector_from_rotation
from pretouch.scene import Scene
from pretouch_detector.proposals.random import draw_candidates

TRANSLATION = 0.02
ROTATION = float(np.radians(5.0))
NOISE = 0.0015


@dataclass(frozen=True)
class Settings:
    """How an image is labelled; the defaults are the paper's unless said otherwise.

    Attributes:
        rectangles, trials: n_R and n_trials.
        matching: by which engine's kernel.
        best_only: compute only the winner's score: other rectangles' trials end as soon as they cannot win.
        near: px, how far from the perimeter the target's points may lie; the paper says "near or on".
    """

    rectangles: int = 1000
    trials: int = 10
    matching: Matching = Matching.PAPER
    best_only: bool = False
    near: float = 6.0


def label_scene(
    scene: Scene, settings: Settings, rng: np.random.Generator, threads: int | None = None
) -> tuple[Array, Array]:
    """Rectangles (r, 5) and their scores (r, t), m; if `best_only`, the winner's scores alone, NaN elsewhere.

    Args:
        threads: None for one per processor. The scores do not depend on it.
    """
    rectangles = np.array([r.as_list() for r in draw_candidates(scene, settings.rectangles, rng)])
    moves = draw_offsets(settings.trials, rng)
    trials = TrialSettings(settings.matching, NOISE, near=settings.near, seed=int(rng.integers(2**31)))
    view = view_of(scene, settings.matching)
    if not settings.best_only:
        return rectangles, compute_scores(view, rectangles, moves, trials, threads)
    winner, _ = find_best(view, rectangles, moves, trials, threads)
    found = np.full((len(rectangles), len(moves)), np.nan)
    found[winner] = compute_scores(view, rectangles[winner : winner + 1], moves, trials, 1, winner)
    return rectangles, found


def draw_offsets(count: int, rng: np.random.Generator) -> Array:
    """(count, 6), rotation vector and translation, rad and m: roll, pitch, yaw and shift uniform, camera axes."""
    angles = rng.uniform(-ROTATION, ROTATION, (count, 3))
    shifts = rng.uniform(-TRANSLATION, TRANSLATION, (count, 3))
    x, y, z = np.eye(3)
    turns = [
        vector_from_rotation(rotation_from_vector(c * z) @ rotation_from_vector(b * y) @ rotation_from_vector(a * x))
        for a, b, c in angles
    ]
    return np.column_stack([np.array(turns), shifts])


def view_of(scene: Scene, matching: Matching) -> View:
    """The scene's cloud in the camera's frame, with normals where the matching needs them."""
    cloud = scene.camera.back_project_image(scene.depth.metres)
    if matching is not Matching.POINT_TO_PLANE:
        return View(cloud, scene.mask, scene.camera)
    normals = camera_model.build(scene).pixels.surface.normals.astype(np.float64)
    return View(cloud, scene.mask, scene.camera, scene.base_T_camera.inverse().rotate(normals))
