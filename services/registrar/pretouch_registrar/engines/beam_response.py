"""Hypotheses about the response of a wide beam, of which users know no more than an approximate half angle.

The range is a weighted mean of the lengths r of the paths in the beam's cone. The weights are the product of the
response in the path's direction, a Gaussian that is one half at some multiple of the stated half angle; of the cosine
of incidence and 1 / r^2 (a Lambertian target); and of exp(-(r - nearest) / L), since time-of-flight modules detect the
front of the returning pulse, which gives the nearest part more weight. A hypothesis is a width and a length L, and it
is calibrated: a perpendicular wall at CALIBRATION_DISTANCE has the range CALIBRATION_DISTANCE. The same hypothesis
holds for a whole session; the objective takes the mean of their likelihoods (`objective`).
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from pretouch.geometry import Array

_RINGS = ((0.0, 1), (0.8, 5), (1.7, 7))
"""Radius, in half angles, and rays of each ring. The tail of the response matters where it meets a nearer surface."""
_WIDTHS = (0.6, 1.2)
"""Multiples of the stated half angle at which the response is one half."""
_DECAYS = 0.0, 32.0, 64.0, 128.0, 256.0
"""1 / L, 1/m: from the third on each is twice the one before, so that its exponential is a square."""
CALIBRATION_DISTANCE = 0.05
"""m: distance of the wall on which users calibrate."""


class Cone(NamedTuple):
    """k rays around a beam's axis and h = w l hypotheses, all lengths for each width; k = 0 for a thin beam.

    Attributes:
        across_x, across_y: (k,), lateral offsets of the rays at unit depth.
        length: (k,), their lengths there.
        profiles: (w, k) response times solid angle.
        decays: (l,) 1 / L, 1/m.
        scales: (h,), calibration factors of the mean length.
    """

    across_x: Array
    across_y: Array
    length: Array
    profiles: Array
    decays: Array
    scales: Array

    def select_hypothesis(self, hypothesis: int) -> Cone:
        """The cone with one of its hypotheses."""
        w, b = divmod(hypothesis, len(self.decays))
        chosen = self.profiles[w : w + 1], self.decays[b : b + 1], self.scales[hypothesis : hypothesis + 1]
        return self._replace(profiles=chosen[0], decays=chosen[1], scales=chosen[2])


def make_thin_beam() -> Cone:
    """The cone of a thin beam: without rays."""
    none = np.zeros(0)
    return Cone(none, none, none, np.zeros((0, 0)), none, none)


def make_cone(half_angle: float) -> Cone:
    """The cone of a module whose stated half angle is `half_angle`, rad."""
    radii = np.concatenate([np.full(count, radius) for radius, count in _RINGS])
    edges = [0.0, *(0.5 * (a + b) for (a, _), (b, _) in pairwise(_RINGS)), _RINGS[-1][0] + 0.25]
    areas = np.concatenate([
        np.full(count, (edges[n + 1] ** 2 - edges[n] ** 2) / count) for n, (_, count) in enumerate(_RINGS)
    ])  # fmt: skip
    turns = np.concatenate([
        2 * np.pi * (np.arange(count) + 0.5 * (n % 2)) / count for n, (_, count) in enumerate(_RINGS)
    ])  # fmt: skip
    tangent, length = np.tan(radii * half_angle), 1.0 / np.cos(radii * half_angle)
    profiles = np.stack([areas * np.exp(-np.log(2.0) * (radii / width) ** 2) for width in _WIDTHS])
    decays = np.array(_DECAYS)
    paths = CALIBRATION_DISTANCE * length
    weights = profiles[:, None] / length / paths**2 * np.exp(-(paths - paths.min()) * decays[:, None])
    means = (weights * paths).sum(axis=-1) / weights.sum(axis=-1)
    return Cone(
        tangent * np.cos(turns), tangent * np.sin(turns), length, profiles, decays, CALIBRATION_DISTANCE / means.ravel()
    )
