"""A depth camera that finds each pixel's disparity by matching a window of the image.

One model for two kinds: structured light whose dots are matched in windows, and stereo. The window's disparity is the
mean over what it sees of *one* surface, so ridges come out rounded; where it holds two, the one that fills more of it
wins, so edges are moved (fattening), and where neither clearly does, there is no depth.

Sources: the effect of windows at discontinuities, Scharstein and Szeliski, "A Taxonomy and Evaluation of Dense
Two-Frame Stereo Correspondence Algorithms", IJCV 2002; of a Kinect's windows, Konolige and Mihelich, "Technical
description of Kinect calibration", ROS wiki 2010 (9 x 9 px); smooth distortion that differs from device to device,
Teichman, Miller, Thrun, "Unsupervised intrinsic calibration of depth sensors via SLAM", RSS 2013; locking to whole
disparities, Shimizu and Okutomi, "Precise sub-pixel estimation on area-based matching", ICCV 2001.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.special import ndtri

from pretouch.camera import Camera, DepthImage
from pretouch.geometry import Array, Pose
from pretouch_simulation.depth_cameras.errors import DisparityErrors
from pretouch_simulation.depth_cameras.fields import smooth_field
from pretouch_simulation.depth_cameras.masks import Outline, distort_outline
from pretouch_simulation.depth_cameras.rendering import SHAPE, Rendering, Sight, look
from pretouch_simulation.world import World

_LEAST_SEEN = 0.4
"""The least share of a window that must have depth."""


@dataclass(frozen=True)
class Window:
    """How windows are matched, in px of the camera's own image.

    Attributes:
        size: its side.
        edge: px of disparity beyond which a step separates two surfaces.
        fattening: px by which the nearer surface reaches beyond its edge; negative: the other eats into it.
        raggedness: px, standard deviation of the same along an edge, from one blob of texture to the next.
        gap: px, median of the band along an edge, on the nearer side, without depth where the step is `full_step` or
            more; along the edge it is log-normal.
        gap_spread: standard deviation of its logarithm.
        full_step: px of disparity.
    """

    size: float
    edge: float
    fattening: float
    raggedness: float
    gap: float
    gap_spread: float
    full_step: float


@dataclass(frozen=True)
class Dropouts:
    """Where the surface is not matched.

    Attributes:
        steepest: rad; beyond this incidence, give or take `_STEEP_SPREAD`, there is no depth.
        dark: share of the image lost in patches of `patch` px, the camera's own.
        speckle: share lost in specks of `speck` px.
    """

    steepest: float
    dark: float
    patch: float
    speckle: float
    speck: float


_STEEP_SPREAD = 0.06
"""rad."""


@dataclass(frozen=True)
class WindowCamera:
    """The camera.

    Attributes:
        baseline: m to the right of the camera, of the projector or the second imager.
        focal: px, of the image in which disparity is measured: the camera's own.
        range: m; there is no depth outside.
        registration: px of the camera's own image, standard deviation along each axis of the shift of the
            whole depth image; drawn once an image.
    """

    baseline: float
    focal: float
    range: tuple[float, float]
    registration: float
    window: Window
    dropouts: Dropouts
    errors: DisparityErrors
    outline: Outline

    def render(
        self,
        world: World,
        camera: Camera,
        base_T_camera: Pose,
        rng: np.random.Generator,
        shape: tuple[int, int] = SHAPE,
    ) -> Rendering:
        """The image of `world` from `base_T_camera`, `shape` = (h, w)."""
        zoom = camera.fx / self.focal
        sight = look(world, camera, base_T_camera, shape, self.baseline)
        matched = self._match(sight, zoom, rng)
        matched = np.where(self._draw_dropouts(sight, zoom, rng), 0.0, matched)
        scale = self.baseline * self.focal
        disparity = self.errors.apply(matched, sight.bodies, scale, zoom, rng)
        metres = scale / np.maximum(disparity, 1e-6)
        good = (disparity > 0) & (metres >= self.range[0]) & (metres <= self.range[1])
        shift = zoom * self.registration * rng.standard_normal(2)
        depth = DepthImage(_misregister(np.where(good, metres, 0.0), zoom, shift).astype(np.float32))
        mask = distort_outline(sight.bodies == 0, self.outline, zoom, rng) & (depth.metres > 0)
        return Rendering(depth, sight.bodies, mask)

    def _match(self, sight: Sight, zoom: float, rng: np.random.Generator) -> Array:
        """(h, w), px: the disparity of the surface that each window is matched to, 0 = none."""
        window = self.window
        size = max(3, int(np.rint(window.size * zoom)))
        true = np.where(sight.lit, self.baseline * self.focal / np.where(sight.depth > 0, sight.depth, 1.0), 0.0)
        near = ndimage.maximum_filter(true, size)
        far = ndimage.minimum_filter(np.where(true > 0, true, np.inf), size)
        step = np.where(np.isfinite(far), near - far, 0.0)
        two = step > window.edge
        front = sight.lit & (~two | (true > near - step / 2))
        seen = _mean(sight.lit.astype(np.float64), size)
        share = _mean(front.astype(np.float64), size)
        of_front = _mean(np.where(front, true, 0.0), size) / np.maximum(share, 1e-9)
        behind = sight.lit & ~front
        of_back = _mean(np.where(behind, true, 0.0), size) / np.maximum(_mean(behind.astype(np.float64), size), 1e-9)
        ragged = window.raggedness * smooth_field(rng, true.shape, zoom * window.size / 3)
        beyond = (share / np.maximum(seen, 1e-9) - 0.5) * window.size + window.fattening + ragged
        value = np.where(~two | (beyond > 0), of_front, of_back)
        gap = window.gap * np.exp(window.gap_spread * smooth_field(rng, true.shape, zoom * window.size / 2))
        gap *= np.clip((step - window.edge) / (window.full_step - window.edge), 0.0, 1.0)
        lost = (two & (beyond > 0) & (beyond < gap)) | (seen < _LEAST_SEEN)
        return np.where(lost, 0.0, value)

    def _draw_dropouts(self, sight: Sight, zoom: float, rng: np.random.Generator) -> NDArray[np.bool_]:
        drop, shape = self.dropouts, sight.depth.shape
        steep = sight.incidence > drop.steepest + _STEEP_SPREAD * smooth_field(rng, shape, zoom * self.window.size)
        dark = smooth_field(rng, shape, zoom * drop.patch) > _threshold(drop.dark)
        speck = smooth_field(rng, shape, zoom * drop.speck) > _threshold(drop.speckle)
        return np.asarray(steep | dark | speck, dtype=np.bool_)


def _misregister(metres: Array, zoom: float, shift: Array) -> Array:
    """The image moved by `shift` (2,), px down and right, with holes as wide as the camera's own pixels, `zoom` px."""
    step = max(zoom, 1.0)
    own = [np.rint(np.arange(n) - by) for n, by in zip(metres.shape, shift, strict=True)]
    v, u = (np.clip(at, 0, n - 1).astype(np.int64) for at, n in zip(own, metres.shape, strict=True))
    moved = metres[np.ix_(v, u)]
    v, u = (
        np.clip((np.floor(at / step) + 0.5) * step, 0, n - 1).astype(np.int64)
        for at, n in zip(own, metres.shape, strict=True)
    )
    coarse = metres[np.ix_(v, u)]
    return np.where((moved > 0) & (coarse > 0), moved, coarse)


def _mean(values: Array, size: int) -> Array:
    return np.asarray(ndimage.uniform_filter(values, size, mode="nearest"), dtype=np.float64)


def _threshold(share: float) -> float:
    """The value that a standard normal variable exceeds with probability `share`."""
    return float(-ndtri(share)) if share > 0 else np.inf
