"""The pose that a perfect finger would find on a real frame: the camera's points fitted onto the true mesh.

The hidden error D is where the frame's ground truth puts the points, but a real depth image is also biased by
millimetres, which the finger rightly finds. The pose fitted here is D followed by the rigid motion (w, d) about the
points' centroid that minimises

    sum_i n_eff / n rho(g_i) / sigma^2 + |w|^2 / (1 deg)^2 + |d|^2 / (3 mm)^2,    rho(g) = c^2 g^2 / (c^2 + g^2),

g_i being the distance of point i from the mesh and rho Geman and McClure's robust kernel (S. Geman, D. McClure,
"Statistical methods for tomographic image reconstruction", 1987). It is minimised by reweighted least squares on the
distances from the closest faces' planes (Y. Chen, G. Medioni, "Object modelling by registration of multiple range
images", 1992), damped as by Levenberg and Marquardt. The prior keeps unobservable directions, such as the
rotation of a can, near D.
"""

from __future__ import annotations

import numpy as np

from pretouch.geometry import Array, Pose, rotation_from_vector, vector_from_rotation
from pretouch_simulation.bvh import Triangles
from pretouch_simulation.protocol import Case
from pretouch_simulation.world import Body

TURN_STD = float(np.radians(1.0))
SHIFT_STD = 0.003
"""m."""
_SURFACE_STD = 0.003
"""m, sigma: the residual of a real depth image against the mesh."""
_EFFECTIVE = 100
"""n_eff: the effective number of points, since the errors of neighbouring pixels are correlated."""
_KERNEL = 0.005
"""m, c."""
_TOUCHING = 1e-9
"""m: below this distance the direction from the closest place is rounding."""
_MOST_POINTS = 4000
_STEPS = 60
_SMALL = 1e-6
"""rad and m: the iteration stops at a smaller step."""


def fit_truth(case: Case) -> Pose:
    """D followed by the best fit: the `base_T_correction` of a case whose first body is the object."""
    return best_fit(case.truth.apply(case.cloud), case.world.bodies[0]) @ case.truth


def best_fit(points: Array, body: Body) -> Pose:
    """The motion that lays points (n, 3), m, in base and near their place, onto the body; see the module."""
    some = points[:: -(-len(points) // _MOST_POINTS)]
    centre = points.mean(axis=0)
    surface = Triangles(body.base_T_mesh.apply(body.mesh.vertices), body.mesh.faces)
    turn, shift, damping = np.eye(3), np.zeros(3), 1e-3
    cost, information, gradient = _linearise(some - centre, centre, turn, shift, surface)
    for _ in range(_STEPS):
        step = -np.linalg.solve(information + damping * np.diag(np.diag(information)), gradient)
        candidate = rotation_from_vector(step[:3]) @ turn, shift + step[3:]
        found = _linearise(some - centre, centre, *candidate, surface)
        if found[0] > cost:
            damping *= 10.0
        else:
            (turn, shift), (cost, information, gradient) = candidate, found
            damping /= 10.0
        if np.abs(step).max() < _SMALL:
            break
    return Pose.of(turn, centre + shift - turn @ centre)


def _gaps(surface: Triangles, points: Array) -> tuple[Array, Array]:
    """Distances (n,), m, of points (n, 3) from the nearest place, and unit directions (n, 3) from there to them.

    On a face the direction is the face's normal.
    """
    places, faces = surface.closest(points)
    gap = points - places
    distances = np.linalg.norm(gap, axis=1)
    normals = surface.normals[faces]
    clear = distances > _TOUCHING
    normals[clear] = gap[clear] / distances[clear, None]
    return distances, normals


def _linearise(arms: Array, centre: Array, turn: Array, shift: Array, surface: Triangles) -> tuple[float, Array, Array]:
    """The cost of a motion, and of its quadratic model in a further (w, d): half the Hessian (6, 6), half the gradient.

    Args:
        arms: (n, 3), m, the points from their centroid `centre`.
    """
    turned = arms @ turn.T
    distances, normals = _gaps(surface, turned + centre + shift)
    shrunk = _KERNEL**2 / (_KERNEL**2 + distances**2)
    scale = _EFFECTIVE / len(arms) / _SURFACE_STD**2
    weights = scale * shrunk**2
    rows = np.concatenate([np.cross(turned, normals), normals], axis=1)
    prior = np.repeat([TURN_STD**-2, SHIFT_STD**-2], 3)
    state = np.concatenate([vector_from_rotation(turn), shift])
    cost = float(scale * (shrunk * distances**2).sum() + (prior * state**2).sum())
    return cost, rows.T @ (weights[:, None] * rows) + np.diag(prior), rows.T @ (weights * distances) + prior * state
