"""A depth camera whose kind and parameters are drawn from wide ranges."""

from __future__ import annotations

import numpy as np

from pretouch_simulation.depth_cameras.errors import DisparityErrors
from pretouch_simulation.depth_cameras.kinect import Kinect
from pretouch_simulation.depth_cameras.masks import Outline
from pretouch_simulation.depth_cameras.matching import Dropouts, Window, WindowCamera
from pretouch_simulation.depth_cameras.rendering import DepthCamera


def drawn(rng: np.random.Generator) -> DepthCamera:
    """One of three kinds, equally likely, with parameters of its own. Ranges are uniform; `_log`: in the logarithm."""
    kind = rng.integers(3)
    if kind == 0:
        return Kinect(_log(rng, 0.5, 2.5), int(rng.choice([3, 5, 7, 9])))
    return _window(rng) if kind == 1 else _stereo(rng)


def _window(rng: np.random.Generator) -> WindowCamera:
    return WindowCamera(
        baseline=rng.uniform(0.06, 0.09),
        focal=rng.uniform(450.0, 650.0),
        range=(0.3, 8.0),
        registration=_log(rng, 0.2, 3.0),
        window=_windows(rng, fattening=(-2.0, 1.5), gap=(0.3, 5.0)),
        dropouts=_dropouts(rng, speckle=(0.0005, 0.01)),
        errors=_errors(rng, locking=(0.005, 0.03), steps=8.0),
        outline=_outline(rng),
    )


def _stereo(rng: np.random.Generator) -> WindowCamera:
    return WindowCamera(
        baseline=rng.uniform(0.04, 0.08),
        focal=rng.uniform(380.0, 700.0),
        range=(0.2, 10.0),
        registration=_log(rng, 0.2, 3.0),
        window=_windows(rng, fattening=(-0.5, 3.0), gap=(0.2, 3.0)),
        dropouts=_dropouts(rng, speckle=(0.003, 0.06)),
        errors=_errors(rng, locking=(0.01, 0.08), steps=32.0),
        outline=_outline(rng),
    )


def _windows(rng: np.random.Generator, fattening: tuple[float, float], gap: tuple[float, float]) -> Window:
    return Window(
        size=rng.uniform(5.0, 21.0),
        edge=rng.uniform(0.8, 2.0),
        fattening=rng.uniform(*fattening),
        raggedness=_log(rng, 0.3, 1.5),
        gap=_log(rng, *gap),
        gap_spread=rng.uniform(0.2, 1.0),
        full_step=rng.uniform(3.0, 8.0),
    )


def _dropouts(rng: np.random.Generator, speckle: tuple[float, float]) -> Dropouts:
    return Dropouts(
        steepest=rng.uniform(1.15, 1.45),
        dark=_log(rng, 0.001, 0.05),
        patch=_log(rng, 3.0, 12.0),
        speckle=_log(rng, *speckle),
        speck=_log(rng, 1.0, 3.0),
    )


def _errors(rng: np.random.Generator, locking: tuple[float, float], steps: float) -> DisparityErrors:
    level = _log(rng, 0.5, 2.0)
    return DisparityErrors(
        noise=(
            (0.5, level * _log(rng, 0.01, 0.08)),
            (_log(rng, 1.0, 3.0), level * _log(rng, 0.03, 0.1)),
            (_log(rng, 3.0, 8.0), level * _log(rng, 0.03, 0.1)),
        ),
        distortion=(
            (_log(rng, 10.0, 30.0), _log(rng, 0.02, 0.08)),
            (_log(rng, 40.0, 150.0), _log(rng, 0.02, 0.1)),
        ),
        gain=_log(rng, 0.0005, 0.006),
        offset=_log(rng, 0.01, 0.1),
        body=_log(rng, 0.01, 0.1),
        locking=_log(rng, *locking),
        steps=steps,
    )


def _outline(rng: np.random.Generator) -> Outline:
    return Outline(
        growth=_log(rng, 0.2, 2.0),
        shift=_log(rng, 0.2, 2.0),
        wander=_log(rng, 0.3, 2.5),
        scale=_log(rng, 5.0, 40.0),
    )


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    """Uniform in the logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
