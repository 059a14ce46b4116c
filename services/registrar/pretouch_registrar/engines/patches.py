"""The effective number of samples that share an error: all returns of one patch of surface share the camera's.

The mean of n samples with independent errors of standard deviation a and a common one of standard deviation b is as
uncertain as that of n (a^2 + b^2) / (a^2 + n b^2) independent samples with both errors: at most 1 + a^2 / b^2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array

_MISS_DEPTH = 0.05
"""m along a beam without a return: the place that decides its patch."""


class SharedError(NamedTuple):
    """Standard deviations, m, of a sample's `own` error and of the `common` one in a cube of side `patch`."""

    own: float
    common: float
    patch: float

    def count_effective(self, count: Array) -> Array:
        """(n,): the effective numbers of `count` (n,) samples of one patch."""
        own, common = self.own**2, self.common**2
        return np.asarray(count * (own + common) / (own + count * common), dtype=np.float64)


class Patches(NamedTuple):
    """The number of samples in each patch: `keys` (k, 4), sorted as by `numpy.unique`, and `counts` (k,)."""

    keys: NDArray[np.int64]
    counts: Array


def find_patches(points: Array, directions: Array, returned: NDArray[np.bool_], error: SharedError) -> Patches:
    """The patches of samples: points (n, 3), m, where a beam ended, or began if it met nothing; directions (n, 3)."""
    keys, counts = np.unique(_find_cubes(points, directions, returned, error.patch), axis=0, return_counts=True)
    return Patches(keys, counts.astype(np.float64))


class Grouping(NamedTuple):
    """n samples by their k patches.

    Attributes:
        place: (n,), index of each sample's patch.
        before: (k,), number of earlier samples in each patch.
    """

    place: NDArray[np.intp]
    before: Array

    def weigh(self, chosen: NDArray[np.bool_], error: SharedError, represented: Array) -> Array:
        """(p, n): by how much each of the samples `chosen` (p, n) would increase the effective number; others' are 0.

        The weights are equal within a patch.

        Args:
            represented: (p,), how many samples each of those chosen stands for.
        """
        count = np.stack([np.bincount(self.place[each], minlength=len(self.before)) for each in chosen])
        gain = error.count_effective(self.before + represented[:, None] * count) - error.count_effective(self.before)
        return np.asarray(chosen * (gain / np.maximum(count, 1.0))[:, self.place], dtype=np.float64)


def group_samples(
    points: Array, directions: Array, returned: NDArray[np.bool_], error: SharedError, earlier: Patches | None = None
) -> Grouping:
    """Samples by their patches, see `find_patches`; `earlier` are the patches of earlier samples."""
    own, place = np.unique(_find_cubes(points, directions, returned, error.patch), axis=0, return_inverse=True)
    before = np.zeros(len(own))
    if earlier is not None and len(earlier.keys) and len(own):
        both, where = np.unique(np.concatenate([earlier.keys, own]), axis=0, return_inverse=True)
        known = np.zeros(len(both))
        where = where.ravel()
        known[where[: len(earlier.keys)]] = earlier.counts
        before = known[where[len(earlier.keys) :]]
    return Grouping(place.ravel(), before)


def compute_sample_weights(points: Array, directions: Array, returned: NDArray[np.bool_], error: SharedError) -> Array:
    """(n,): by how much each sample increases the effective number; see `find_patches` and `Grouping.weigh`."""
    grouping = group_samples(points, directions, returned, error)
    weights: Array = grouping.weigh(np.ones((1, len(points)), dtype=np.bool_), error, np.ones(1))[0]
    return weights


def _find_cubes(points: Array, directions: Array, returned: NDArray[np.bool_], patch: float) -> NDArray[np.int64]:
    """(n, 4): the cube of side `patch` that each sample lies in; misses have their own."""
    places = points + np.where(returned, 0.0, _MISS_DEPTH)[:, None] * directions
    return np.column_stack([np.floor(places / patch), returned]).astype(np.int64)
