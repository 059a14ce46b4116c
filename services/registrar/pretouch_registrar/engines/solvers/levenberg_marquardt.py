"""Refines a correction by Levenberg-Marquardt steps with robust weights."""

from __future__ import annotations

import numpy as np
from numba import njit

from pretouch.geometry import Array
from pretouch_registrar.engines import so3
from pretouch_registrar.engines.objective import linearize
from pretouch_registrar.engines.registration_problem import RegistrationProblem

_STEPS = 12


@njit(cache=True, nogil=True)
def refine(x: Array, problem: RegistrationProblem) -> Array:
    """The local minimum (6,) that is reached from x (6,); a problem of wide beams must have a single hypothesis."""
    damping = 1e-3
    information, gradient, energy = linearize(x, problem)
    for _ in range(_STEPS):
        damped = information.copy()
        for k in range(6):
            damped[k, k] *= 1.0 + damping
        step: Array = np.linalg.solve(damped, -gradient).astype(np.float64)
        turn: Array = so3.log(so3.exp(step[:3]) @ so3.exp(x[:3]))
        moved = np.concatenate((turn, x[3:] + step[3:]))
        new_information, new_gradient, new_energy = linearize(moved, problem)
        if new_energy < energy:
            gain = energy - new_energy
            x, information, gradient, energy = moved, new_information, new_gradient, new_energy
            damping = max(damping / 5, 1e-6)
            if gain < 1e-4:
                break
        else:
            damping *= 8
            if damping > 1e4:
                break
    return x
