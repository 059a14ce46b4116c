"""What samples are worth that share an error: all returns of one patch of the world err together with the camera.

n samples with an error of their own, standard deviation a, and one in common, b, tell their mean as well as
n (a^2 + b^2) / (a^2 + n b^2) independent ones with both errors: at most 1 + a^2 / b^2, however many they are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array

_MISS_DEPTH = 0.05
"""m along a beam without a return where it is taken to have been."""


class SharedError(NamedTuple):
    """Standard deviations, m, of one sample's `own` error and of the `common` one of all in a cube of side `patch`."""

    own: float
    common: float
    patch: float

    def worth(self, count: Array) -> Array:
        """Independent samples that `count` (n,) samples of one patch are worth."""
        own, common = self.own**2, self.common**2
        return np.asarray(count * (own + common) / (own + count * common), dtype=np.float64)


class Patches(NamedTuple):
    """How many samples lie in each patch: `keys` (k, 4), sorted as `numpy.unique` sorts rows, and `counts` (k,)."""

    keys: NDArray[np.int64]
    counts: Array


def patches_of(points: Array, directions: Array, returned: NDArray[np.bool_], error: SharedError) -> Patches:
    """The patches of samples: points (n, 3), m, where a beam ended, or began if it met nothing; directions (n, 3)."""
    keys, counts = np.unique(_keys(points, directions, returned, error.patch), axis=0, return_counts=True)
    return Patches(keys, counts.astype(np.float64))


def sample_weights(
    points: Array,
    directions: Array,
    returned: NDArray[np.bool_],
    error: SharedError,
    each: float = 1.0,
    earlier: Patches | None = None,
) -> Array:
    """(n,): what each sample adds in independent samples, all of one patch the same; arguments as `patches_of`.

    Args:
        each: how many samples each of these stands for.
        earlier: of samples that are known already, so that these tell only what is new.
    """
    if not len(points):
        return np.zeros(0)
    own, place, count = np.unique(
        _keys(points, directions, returned, error.patch), axis=0, return_inverse=True, return_counts=True
    )
    before = np.zeros(len(own))
    if earlier is not None and len(earlier.keys):
        both, where = np.unique(np.concatenate([earlier.keys, own]), axis=0, return_inverse=True)
        known = np.zeros(len(both))
        where = where.ravel()
        known[where[: len(earlier.keys)]] = earlier.counts
        before = known[where[len(earlier.keys) :]]
    gain = error.worth(before + each * count) - error.worth(before)
    return np.asarray((gain / count)[place.ravel()], dtype=np.float64)


def _keys(points: Array, directions: Array, returned: NDArray[np.bool_], patch: float) -> NDArray[np.int64]:
    """(n, 4): the cube of side `patch` that each sample lies in; misses have their own."""
    places = points + np.where(returned, 0.0, _MISS_DEPTH)[:, None] * directions
    return np.column_stack([np.floor(places / patch), returned]).astype(np.int64)
