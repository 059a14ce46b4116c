"""Whether samples that are said to come from a thin beam are explained better by a wide one.

A wide beam sees the nearest part of its spot: over an edge its range changes gradually, and before the edge already.
Read as a thin beam's, such ranges fit a wrong place nearly as well, so that the residuals alone do not give it away.
Both descriptions are compared at the best correction of each, on the same few beams.
"""

from __future__ import annotations

import numpy as np

from pretouch.geometry import Array
from pretouch_registrar.engines.objective import energy_of, supposing_likeliest
from pretouch_registrar.engines.problem import Problem
from pretouch_registrar.engines.resources import Resources
from pretouch_registrar.engines.solvers.levenberg_marquardt import refine

SUPPOSED_HALF_ANGLE = float(np.radians(12.5))
"""rad: of the wide beam; proximity modules have 10 to 14 deg."""
_BEAMS = 80
_BIAS = 0.006
"""m: about how much too high an object seems that a wide beam reads as a thin one; where the second search begins."""
_EVIDENCE = -0.2
"""Logarithm of the likelihood ratio, per sample's worth, above which the beam is taken for a wide one. Below 0, since
where there are no edges both explain the samples and the thin beam's smaller noise decides. On 28 views of training
meshes after 1, 2 and 3 scans it names 14, 11 and 7 % of the fingers that are thin, mostly over flat things, where the
wide beam's answer is the same but less sure; and 68, 64 and 89 % of the fingers `cone`."""


def measures_wide(x: Array, thin: Problem, wide: Problem, resources: Resources) -> bool:
    """Whether `wide`, the same scans as a wide beam's, explains the samples better than `thin` does about x (6,).

    Never of points whose ranges nobody knows (`Scan.of_points`).
    """
    wide = wide.pooled().thinned(_BEAMS)
    if (wide.beams.ranges[wide.beams.returned] == 0.0).any():
        return False
    thin = thin._replace(beams=wide.beams, temperature=wide.temperature)
    returns = float(wide.beams.weights[wide.beams.returned].sum()) / wide.temperature
    if returns <= 0.0:
        return False
    lower = x - np.concatenate([np.zeros(3), _BIAS * thin.target.table.normal])
    as_thin = min(energy_of(x, thin), energy_of(refine(x, thin), thin))
    as_wide = min(resources.map(lambda start: _refined_energy(start, wide), (x, lower)))
    ratio = as_thin - as_wide - returns * np.log(wide.noise.surface / thin.noise.surface)
    return bool(ratio > _EVIDENCE * returns)


def _refined_energy(x: Array, wide: Problem) -> float:
    for _ in range(2):
        x = refine(x, supposing_likeliest(x, wide))
    return float(energy_of(x, wide))
