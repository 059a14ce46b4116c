"""`random`: a depth camera whose kind and parameters are drawn from wide ranges."""

from __future__ import annotations

import numpy as np

from pretouch_simulation.depth_cameras.errors import DisparityErrors
from pretouch_simulation.depth_cameras.kinect import Kinect
from pretouch_simulation.depth_cameras.masks import Outline
from pretouch_simulation.depth_cameras.matching import Dropouts, Window, WindowCamera
from pretouch_simulation.depth_cameras.rendering import DepthCamera
from pretouch_simulation.draws import draw_log_uniform


def draw(rng: np.random.Generator) -> DepthCamera:
    """One of three kinds, equally likely, with parameters of its own. Ranges are uniform, some in the logarithm."""
    kind = rng.integers(3)
    if kind == 0:
        return Kinect(draw_log_uniform(rng, 0.5, 2.5), int(rng.choice([3, 5, 7, 9])))
    return _draw_window_camera(rng) if kind == 1 else _draw_stereo_camera(rng)


def _draw_window_camera(rng: np.random.Generator) -> WindowCamera:
    return WindowCamera(
        baseline=rng.uniform(0.06, 0.09),
        focal=rng.uniform(450.0, 650.0),
        range=(0.3, 8.0),
        registration=draw_log_uniform(rng, 0.2, 3.0),
        window=_draw_windows(rng, fattening=(-2.0, 1.5), gap=(0.3, 5.0)),
        dropouts=_draw_dropouts(rng, speckle=(0.0005, 0.01)),
        errors=_draw_errors(rng, locking=(0.005, 0.03), steps=8.0),
        outline=_draw_outline(rng),
    )


def _draw_stereo_camera(rng: np.random.Generator) -> WindowCamera:
    return WindowCamera(
        baseline=rng.uniform(0.04, 0.08),
        focal=rng.uniform(380.0, 700.0),
        range=(0.2, 10.0),
        registration=draw_log_uniform(rng, 0.2, 3.0),
        window=_draw_windows(rng, fattening=(-0.5, 3.0), gap=(0.2, 3.0)),
        dropouts=_draw_dropouts(rng, speckle=(0.003, 0.06)),
        errors=_draw_errors(rng, locking=(0.01, 0.08), steps=32.0),
        outline=_draw_outline(rng),
    )


def _draw_windows(rng: np.random.Generator, fattening: tuple[float, float], gap: tuple[float, float]) -> Window:
    return Window(
        size=rng.uniform(5.0, 21.0),
        edge=rng.uniform(0.8, 2.0),
        fattening=rng.uniform(*fattening),
        raggedness=draw_log_uniform(rng, 0.3, 1.5),
        gap=draw_log_uniform(rng, *gap),
        gap_spread=rng.uniform(0.2, 1.0),
        full_step=rng.uniform(3.0, 8.0),
    )


def _draw_dropouts(rng: np.random.Generator, speckle: tuple[float, float]) -> Dropouts:
    return Dropouts(
        steepest=rng.uniform(1.15, 1.45),
        dark=draw_log_uniform(rng, 0.001, 0.05),
        patch=draw_log_uniform(rng, 3.0, 12.0),
        speckle=draw_log_uniform(rng, *speckle),
        speck=draw_log_uniform(rng, 1.0, 3.0),
    )


def _draw_errors(rng: np.random.Generator, locking: tuple[float, float], steps: float) -> DisparityErrors:
    level = draw_log_uniform(rng, 0.5, 2.0)
    return DisparityErrors(
        noise=(
            (0.5, level * draw_log_uniform(rng, 0.01, 0.08)),
            (draw_log_uniform(rng, 1.0, 3.0), level * draw_log_uniform(rng, 0.03, 0.1)),
            (draw_log_uniform(rng, 3.0, 8.0), level * draw_log_uniform(rng, 0.03, 0.1)),
        ),
        distortion=(
            (draw_log_uniform(rng, 10.0, 30.0), draw_log_uniform(rng, 0.02, 0.08)),
            (draw_log_uniform(rng, 40.0, 150.0), draw_log_uniform(rng, 0.02, 0.1)),
        ),
        gain=draw_log_uniform(rng, 0.0005, 0.006),
        offset=draw_log_uniform(rng, 0.01, 0.1),
        body=draw_log_uniform(rng, 0.01, 0.1),
        locking=draw_log_uniform(rng, *locking),
        steps=steps,
    )


def _draw_outline(rng: np.random.Generator) -> Outline:
    return Outline(
        growth=draw_log_uniform(rng, 0.2, 2.0),
        shift=draw_log_uniform(rng, 0.2, 2.0),
        wander=draw_log_uniform(rng, 0.3, 2.5),
        scale=draw_log_uniform(rng, 5.0, 40.0),
    )
