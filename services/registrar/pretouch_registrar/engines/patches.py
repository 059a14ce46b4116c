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


def compute_sample_weights(
    points: Array,
    directions: Array,
    returned: NDArray[np.bool_],
    error: SharedError,
    each: float = 1.0,
    earlier: Patches | None = None,
) -> Array:
    """(n,): by how much each sample increases the effective number; equal within a patch. See `find_patches`.

    Args:
        each: how many samples each of these represents.
        earlier: the patches of earlier samples, to which these are added.
    """
    if not len(points):
        return np.zeros(0)
    own, place, count = np.unique(
        _find_cubes(points, directions, returned, error.patch), axis=0, return_inverse=True, return_counts=True
    )
    before = np.zeros(len(own))
    if earlier is not None and len(earlier.keys):
        both, where = np.unique(np.concatenate([earlier.keys, own]), axis=0, return_inverse=True)
        known = np.zeros(len(both))
        where = where.ravel()
        known[where[: len(earlier.keys)]] = earlier.counts
        before = known[where[len(earlier.keys) :]]
    gain = error.count_effective(before + each * count) - error.count_effective(before)
    return np.asarray((gain / count)[place.ravel()], dtype=np.float64)


def _find_cubes(points: Array, directions: Array, returned: NDArray[np.bool_], patch: float) -> NDArray[np.int64]:
    """(n, 4): the cube of side `patch` that each sample lies in; misses have their own."""
    places = points + np.where(returned, 0.0, _MISS_DEPTH)[:, None] * directions
    return np.column_stack([np.floor(places / patch), returned]).astype(np.int64)
