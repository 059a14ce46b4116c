"""Tests whether a wide beam explains the samples better than the thin beam that the client stated.

A wide beam measures the nearest part of its spot, so that over an edge its range changes gradually and too early. Read
as a thin beam's, such ranges fit a wrong correction nearly as well, and the residuals alone do not show the mistake.
Therefore both models are compared, each at its own best correction, on the same few beams.
"""

from __future__ import annotations

import numpy as np

from pretouch.geometry import Array
from pretouch_registrar.engines.objective import assume_likeliest_hypothesis, compute_energy
from pretouch_registrar.engines.registration_problem import RegistrationProblem
from pretouch_registrar.engines.resources import Resources
from pretouch_registrar.engines.solvers.levenberg_marquardt import refine

ASSUMED_HALF_ANGLE = float(np.radians(12.5))
"""rad: half angle of the wide beam; proximity modules have 10 to 14 deg."""
_BEAMS = 80
_BIAS = 0.006
"""m: about how much too high an object appears when a wide beam is read as a thin one: a second initial guess."""
_MIN_LOG_RATIO = -0.2
"""Log likelihood ratio, per effective sample, above which the beam is taken to be wide. It is below 0, since without
edges both models explain the samples, and the thin beam's smaller noise decides. On 28 views of training meshes, after
1, 2 and 3 scans, 14, 11 and 7 % of the thin beams are taken to be wide, mostly over flat objects, where the estimate is
the same but less certain; of the fingers `cone` it is 68, 64 and 89 %."""


def is_wide_beam(x: Array, thin: RegistrationProblem, wide: RegistrationProblem, resources: Resources) -> bool:
    """Whether `wide`, the same scans with a wide beam, explains the samples better than `thin` does near x (6,).

    False for points without ranges (`Scan.of_points`).
    """
    wide = wide.pool_beams().subsample_beams(_BEAMS)
    if (wide.beams.ranges[wide.beams.returned] == 0.0).any():
        return False
    thin = thin._replace(beams=wide.beams, temperature=wide.temperature)
    returns = float(wide.beams.weights[wide.beams.returned].sum()) / wide.temperature
    if returns <= 0.0:
        return False
    lower = x - np.concatenate([np.zeros(3), _BIAS * thin.target.table.normal])
    as_thin = min(compute_energy(x, thin), compute_energy(refine(x, thin), thin))
    as_wide = min(resources.map(lambda start: _refine_energy(start, wide), (x, lower)))
    ratio = as_thin - as_wide - returns * np.log(wide.noise.surface / thin.noise.surface)
    return bool(ratio > _MIN_LOG_RATIO * returns)


def _refine_energy(x: Array, wide: RegistrationProblem) -> float:
    for _ in range(2):
        x = refine(x, assume_likeliest_hypothesis(x, wide))
    return float(compute_energy(x, wide))
