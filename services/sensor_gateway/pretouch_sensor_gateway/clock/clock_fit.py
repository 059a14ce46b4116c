"""Fits the line from device time to host time through moments whose host times are uncertain.

Generalised least squares (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, section 2.7). Host
minus device time is a line, plus what the oscillator's rate wanders as a random walk, whose integral has the covariance
q s^2 (3 t - s) / 6 between ages s <= t. How fast it wanders, q, is the one of four that explains the moments best
(marginal likelihood), for a crystal keeps its rate a hundred times better than an RC oscillator does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pretouch.geometry import Array

DRIFT_STD = 0.03
"""Prior standard deviation of the drift, s/s: crystals are good to 1e-4, ceramic resonators to 5e-3, the RC
oscillators inside microcontrollers to 1e-2 when trimmed and 1e-1 when not. Half a second of pings outweighs it."""
MEMORY = 3600.0
"""Seconds after which a moment is no longer used."""
WANDERS = 8e-14 * np.array([1.0, 30.0, 1e3, 3e4])
"""q, (s/s)^2 a second: the first is 10 ppm in twenty minutes, a crystal in a room; the last is 0.3 % in an hour."""
_WORSE_OSCILLATOR = 4.0
"""How much more likely, in logarithms, each of these is than the next, before any is measured."""
_PRIOR_MOMENTS = 4.0
"""The stated noise counts as much as that many measured moments against what the residuals say of it."""


@dataclass(frozen=True)
class ClockFit:
    """A fitted clock.

    Attributes:
        origin: device time of the newest moment, s.
        offset: host minus device time there, s.
        slope: by how much that grows with each second of the device.
        offset_variance: s^2.
        covariance: of offset and slope, s.
        slope_variance: of the slope.
        wander: q, (s/s)^2 a second.
    """

    origin: float
    offset: float
    slope: float
    offset_variance: float
    covariance: float
    slope_variance: float
    wander: float

    def at(self, device: float) -> tuple[float, float]:
        """Host time of a device time, s, and its variance, s^2, which grows with the distance from the moments."""
        age = device - self.origin
        variance = self.offset_variance + age * (2 * self.covariance + age * self.slope_variance)
        return device + self.offset + self.slope * age, variance + self.wander * abs(age * age * age) / 3


def fit_clock(device: Array, host: Array, noise: Array, lateness: Array) -> ClockFit:
    """Fits a clock to n >= 1 moments.

    Args:
        device: (n,) device times, s.
        host: (n,) host times, s.
        noise: (n,) variances of these, s^2, above 0.
        lateness: (n,) s. The share of it, -1 to 1, by which the host times are late is estimated with the line.
    """
    origin, first = device.max(), host[0] - device[0]
    age = origin - device
    offsets = host - device - first
    near, far = np.minimum.outer(age, age), np.maximum.outer(age, age)
    walk = near * near * (3 * far - near) / 6
    covariances = WANDERS[:, None, None] * walk + np.diag(noise)
    model = np.column_stack([np.ones_like(age), -age, lateness])
    columns = np.column_stack([model, offsets])
    weighted = np.linalg.solve(covariances, np.broadcast_to(columns, (len(WANDERS), *columns.shape)))
    precision = np.diag([0.0, DRIFT_STD**-2, 3.0])  # a share uniform in [-1, 1] has the variance 1/3
    normal = model.T @ weighted[:, :, :3] + precision
    estimates = np.linalg.solve(normal, model.T @ weighted[:, :, 3:])
    misses = np.concatenate([-estimates, np.ones((len(WANDERS), 1, 1))], axis=1)
    misfits = np.sum((columns @ misses) * (weighted @ misses), axis=(1, 2))
    likelihood = -0.5 * (
        misfits
        + np.sum(estimates * (precision @ estimates), axis=(1, 2))
        + 2 * np.log(np.diagonal(np.linalg.cholesky(covariances), axis1=1, axis2=2)).sum(axis=1)
        + np.linalg.slogdet(normal).logabsdet
    )
    best = int(np.argmax(likelihood - _WORSE_OSCILLATOR * np.arange(len(WANDERS))))
    scale = (misfits[best] + _PRIOR_MOMENTS) / (len(age) + _PRIOR_MOMENTS)
    covariance = np.linalg.inv(normal[best]) * scale
    return ClockFit(
        float(origin),
        float(first + estimates[best, 0, 0]),
        float(estimates[best, 1, 0]),
        float(covariance[0, 0]),
        float(covariance[0, 1]),
        float(covariance[1, 1]),
        float(WANDERS[best]),
    )
