"""Errors of a matched disparity: noise on several scales, distortion, gain, pixel locking, quantisation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_simulation.depth_cameras.fields import block_field, smooth_field


@dataclass(frozen=True)
class DisparityErrors:
    """All in px of the camera's own image.

    Attributes:
        noise: pairs of scale, px, and standard deviation, px of disparity.
        distortion: the same, of the camera's smooth distortion.
        gain: standard deviation of the relative error of the depth, drawn once an image.
        offset: px of disparity, standard deviation of an offset of all pixels, drawn once an image.
        body: px of disparity, standard deviation of an offset of all pixels of one body, or of the table.
        locking: px, amplitude of the pixel locking, which pulls disparities towards whole pixels.
        steps: quantisation steps of the disparity per px.
    """

    noise: tuple[tuple[float, float], ...]
    distortion: tuple[tuple[float, float], ...]
    gain: float
    offset: float
    body: float
    locking: float
    steps: float

    def apply(
        self, disparity: Array, bodies: NDArray[np.int64], scale: float, zoom: float, rng: np.random.Generator
    ) -> Array:
        """The measured disparity of a true one (h, w), px, 0 = none.

        Args:
            bodies: (h, w), whose surface each pixel is.
            scale: m px, baseline times focal length.
            zoom: px of the image to one of the camera's own.
        """
        shape = disparity.shape
        there = disparity > 0
        error = np.full(shape, self.offset * rng.standard_normal())
        for size, spread in (*self.noise, *self.distortion):
            field = smooth_field(rng, shape, zoom * size) if size >= 1 else block_field(rng, shape, zoom)
            error += spread * field
        present = np.unique(bodies)
        error += self.body * rng.standard_normal(len(present))[np.searchsorted(present, bodies)]
        measured = disparity * (1.0 + self.gain * rng.standard_normal()) + error
        measured -= self.locking * np.sin(2 * np.pi * measured)
        return np.where(there, np.maximum(np.rint(measured * self.steps) / self.steps, 0.0), 0.0)
