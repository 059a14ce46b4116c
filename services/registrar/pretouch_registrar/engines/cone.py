"""How a wide beam may respond to what lies in its spot: hypotheses, since no user knows it better than roughly.

A module's range is a mean over the paths r of its spot, each weighted by the response of its direction, a Gaussian
that is a half at some share of the stated half angle; by the cosine of the incidence and 1 / r^2 (a Lambertian target);
and by exp(-(r - nearest) / L): time-of-flight modules follow the front of the returning pulse, so that the nearest part
counts for more. Every hypothesis, a width and a length L, reads the distance of a perpendicular wall at CALIBRATED. One
of them holds for a whole session; the objective takes the mean of their likelihoods (`objective`).
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from pretouch.geometry import Array

_RINGS = ((0.0, 1), (0.8, 5), (1.7, 7))
"""Radius, in half angles, and rays of each ring. The response's tail counts: what stands nearer there outweighs it."""
_WIDTHS = (0.6, 1.2)
"""Half angles at which the response is a half."""
_NEAREST = 0.0, 32.0, 64.0, 128.0, 256.0
"""1 / L, 1/m: each but the first two twice the one before, so that their exponentials are squares."""
CALIBRATED = 0.05
"""m: distance of the wall on which a user calibrates."""


class Cone(NamedTuple):
    """k rays about a beam's axis and h = w l hypotheses, of each width all lengths; k = 0 for a thin beam.

    Attributes:
        across_x, across_y: (k,) lateral offsets at unit depth.
        length: (k,) path there.
        profiles: (w, k) response times solid angle.
        decays: (l,) 1 / L, 1/m.
        scales: (h,) by which a mean path is multiplied, so that the wall reads its distance.
    """

    across_x: Array
    across_y: Array
    length: Array
    profiles: Array
    decays: Array
    scales: Array

    def only(self, hypothesis: int) -> Cone:
        """With one of the hypotheses."""
        w, b = divmod(hypothesis, len(self.decays))
        chosen = self.profiles[w : w + 1], self.decays[b : b + 1], self.scales[hypothesis : hypothesis + 1]
        return self._replace(profiles=chosen[0], decays=chosen[1], scales=chosen[2])


def thin_beam() -> Cone:
    """Without rays."""
    none = np.zeros(0)
    return Cone(none, none, none, np.zeros((0, 0)), none, none)


def cone_of(half_angle: float) -> Cone:
    """The hypotheses about a module that is said to have this half angle, rad."""
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
    decays = np.array(_NEAREST)
    paths = CALIBRATED * length
    weights = profiles[:, None] / length / paths**2 * np.exp(-(paths - paths.min()) * decays[:, None])
    means = (weights * paths).sum(axis=-1) / weights.sum(axis=-1)
    return Cone(tangent * np.cos(turns), tangent * np.sin(turns), length, profiles, decays, CALIBRATED / means.ravel())
