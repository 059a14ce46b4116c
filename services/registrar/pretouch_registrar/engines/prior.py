"""The prior of a correction x = (w, d), in coordinates in which it is round: `z = whiten x`.

A calibration error that only its size is known of is nearly uniform in each z up to a bound, as such errors are. One
that a mean and a covariance are stated of is normal; its mean is no correction, since the scene is moved by it first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from pretouch.geometry import Array
from pretouch.prior import CONTRADICTION, AnyPrior, PosePrior

FLAT_SIGMAS = 1.65
"""Standard deviations up to which the prior is nearly flat; a uniform error's bound is sqrt 3 of them."""
FALL_OFF_SIGMAS = 0.2
"""Standard deviations over which the density falls off beyond FLAT_SIGMAS."""
FLAT_COST_SHARE = 0.1
"""Share of a normal prior's cost that counts within FLAT_SIGMAS."""
_USUAL, _MOST = 1.5, 2.6
"""Standard deviations of the largest component up to which a correction is usual under a flat prior, and beyond which
it contradicts it."""
_USUAL_NORMAL = 3.55
"""The same for the Mahalanobis distance under a normal prior, within which 95 % of corrections are."""


class CorrectionPrior(NamedTuple):
    """The prior for compiled kernels.

    Attributes:
        root: (6, 6), the lower Cholesky factor of its covariance.
        whiten: (6, 6), the inverse of `root`; 0 for no prior.
        precision: (6, 6), the inverse of its covariance; 0 for no prior.
        normal: whether the density is normal, and not nearly flat.
    """

    root: Array
    whiten: Array
    precision: Array
    normal: bool

    @staticmethod
    def of(prior: AnyPrior) -> CorrectionPrior:
        """The prior without its mean."""
        root: Array = np.linalg.cholesky(prior.covariance).astype(np.float64)
        whiten = np.tril(np.linalg.inv(root))
        return CorrectionPrior(root, whiten, np.ascontiguousarray(whiten.T @ whiten), isinstance(prior, PosePrior))

    @property
    def covariance(self) -> Array:
        """(6, 6)."""
        return np.asarray(self.root @ self.root.T, dtype=np.float64)

    def removed(self) -> CorrectionPrior:
        """No prior."""
        return self._replace(whiten=np.zeros((6, 6)), precision=np.zeros((6, 6)))

    def find_excess(self, x: Array) -> float:
        """Standard deviations by which the correction x (6,) is farther than usual; at most 0 if it is not."""
        z = self.whiten @ x
        return float(np.linalg.norm(z) - _USUAL_NORMAL if self.normal else np.abs(z).max() - _USUAL)

    def is_contradicted_by(self, x: Array) -> bool:
        """Whether the correction x (6,) is so far that either it or the prior is wrong."""
        z = self.whiten @ x
        return bool(z @ z > CONTRADICTION if self.normal else np.abs(z).max() > _MOST)

    def bound(self, covariance: Array, most: float = 1.0) -> Array:
        """The covariance (6, 6), in no direction with a larger variance than `most` times the prior's there."""
        values, vectors = np.linalg.eigh(self.whiten @ covariance @ self.whiten.T)
        bounded = self.root @ (vectors * np.minimum(values, most)) @ vectors.T @ self.root.T
        return np.asarray(0.5 * (bounded + bounded.T), dtype=np.float64)


@njit(cache=True, nogil=True, inline="always")
def _cost(z: float, normal: bool) -> tuple[float, float, float]:
    """Cost of one component in standard deviations, and its first and second derivative."""
    if normal:
        return 0.5 * z * z, z, 1.0
    beyond = abs(z) - FLAT_SIGMAS
    cost, slope, bend = 0.5 * FLAT_COST_SHARE * z * z, FLAT_COST_SHARE * z, FLAT_COST_SHARE
    if beyond > 0:
        cost += 0.5 * (beyond / FALL_OFF_SIGMAS) ** 2
        slope += np.sign(z) * beyond / FALL_OFF_SIGMAS**2
        bend += 1.0 / FALL_OFF_SIGMAS**2
    return cost, slope, bend


@njit(cache=True, nogil=True, error_model="numpy")
def compute_prior_cost(x: Array, prior: CorrectionPrior) -> float:
    """The negative log density of the correction x (6,), up to a constant."""
    total = 0.0
    for k in range(6):
        z = 0.0
        for m in range(k + 1):
            z += prior.whiten[k, m] * x[m]
        total += _cost(z, prior.normal)[0]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def add_prior(x: Array, prior: CorrectionPrior, information: Array, gradient: Array) -> float:
    """Adds the prior to the normal equations, information (6, 6) and gradient (6,), at x (6,); returns its cost."""
    total = 0.0
    for k in range(6):
        row = prior.whiten[k]
        z = 0.0
        for m in range(k + 1):
            z += row[m] * x[m]
        cost, slope, bend = _cost(z, prior.normal)
        total += cost
        for i in range(k + 1):
            gradient[i] += slope * row[i]
            for j in range(k + 1):
                information[i, j] += bend * row[i] * row[j]
    return total
