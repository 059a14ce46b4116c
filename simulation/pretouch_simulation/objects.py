"""Household objects made in code. All stand on z = 0, centred on x = y = 0; watertight unless said otherwise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from pretouch.geometry import Pose, rotation_from_vector
from pretouch_simulation.mesh import Mesh

_SIDES = 64


def box(x: float = 0.09, y: float = 0.06, z: float = 0.14) -> Mesh:
    """A cuboid with sides x, y, z, m."""
    signs = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)], dtype=np.float64)
    vertices = (signs - [0.5, 0.5, 0.0]) * [x, y, z]
    quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    return Mesh(vertices, np.array([[q[0], q[k], q[k + 1]] for q in quads for k in (1, 2)]))


def lathe(profile: ArrayLike, sides: int = _SIDES) -> Mesh:
    """A solid of revolution about z.

    Args:
        profile: (n, 2) as (radius, height), m, from a point on the axis around the outside to a point on the axis.
        sides: segments around the axis.
    """
    outline = np.asarray(profile, dtype=np.float64)
    angles = 2 * np.pi * np.arange(sides) / sides
    rings = [
        np.stack([r * np.cos(angles), r * np.sin(angles), np.full(sides, h)], axis=1)
        if r > 0
        else np.array([[0, 0, h]])
        for r, h in outline
    ]
    starts = np.cumsum([0, *(len(ring) for ring in rings)])
    k = np.arange(sides)
    following = (k + 1) % sides
    faces = []
    for ring in range(len(rings) - 1):
        low, high = starts[ring], starts[ring + 1]
        low_k, low_next = (low + k, low + following) if len(rings[ring]) > 1 else (np.full(sides, low),) * 2
        high_k, high_next = (high + k, high + following) if len(rings[ring + 1]) > 1 else (np.full(sides, high),) * 2
        if len(rings[ring]) > 1:
            faces.append(np.stack([low_k, low_next, high_next], axis=1))
        if len(rings[ring + 1]) > 1:
            faces.append(np.stack([low_k, high_next, high_k], axis=1))
    return Mesh(np.concatenate(rings), np.concatenate(faces))


def sweep(centres: ArrayLike, radius: float, sides: int = 16) -> Mesh:
    """A round bar, `radius` m, along the points `centres` (n, 3) of a curve in the x-z plane, closed at both ends."""
    path = np.asarray(centres, dtype=np.float64)
    tangents = np.gradient(path, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    across = np.array([0.0, 1.0, 0.0])
    angles = 2 * np.pi * np.arange(sides) / sides
    rings = [
        centre + radius * (np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * np.cross(tangent, across))
        for centre, tangent in zip(path, tangents, strict=True)
    ]
    n = len(rings)
    vertices = np.concatenate([*rings, path[:1], path[-1:]])
    k = np.arange(sides)
    following = (k + 1) % sides
    faces = [
        np.concatenate(
            [
                np.stack([ring * sides + k, ring * sides + following, (ring + 1) * sides + following], axis=1),
                np.stack([ring * sides + k, (ring + 1) * sides + following, (ring + 1) * sides + k], axis=1),
            ]
        )
        for ring in range(n - 1)
    ]
    first, last = n * sides, n * sides + 1
    faces.append(np.stack([np.full(sides, first), following, k], axis=1))
    faces.append(np.stack([np.full(sides, last), (n - 1) * sides + k, (n - 1) * sides + following], axis=1))
    return Mesh(vertices, np.concatenate(faces))


def can(radius: float = 0.033, height: float = 0.12) -> Mesh:
    """A drinks can with its bevelled ends."""
    bevel = 0.15 * radius
    return lathe(
        [(0, 0), (radius - bevel, 0), (radius, bevel), (radius, height - bevel), (radius - bevel, height), (0, height)]
    )


def bottle(radius: float = 0.035, height: float = 0.21) -> Mesh:
    """A bottle with shoulder, neck and cap."""
    shoulder = [
        (0.35 * radius + 0.65 * radius * np.cos(a), 0.6 * height + 0.2 * height * np.sin(a))
        for a in np.linspace(0, np.pi / 2, 9)
    ]
    neck = [(0.35 * radius, 0.9 * height), (0.42 * radius, 0.9 * height), (0.42 * radius, height), (0, height)]
    return lathe([(0, 0), (radius, 0), *shoulder, *neck])


def bowl(radius: float = 0.08, height: float = 0.06, wall: float = 0.004) -> Mesh:
    """A bowl: part of a spherical shell on a flat foot."""
    foot = 0.45 * radius
    angles = np.linspace(np.arcsin(foot / radius), np.pi / 2, 17)
    rise = (1 - np.cos(angles)) - (1 - np.cos(angles[0]))
    heights = rise / rise[-1] * height
    outer = np.stack([radius * np.sin(angles), heights], axis=1)
    inner = np.stack([outer[:, 0] - wall, wall + heights * (height - wall) / height], axis=1)
    return lathe(np.concatenate([[(0, 0)], outer, inner[::-1], [(0, wall)]]))


def mug(radius: float = 0.04, height: float = 0.095, wall: float = 0.004) -> Mesh:
    """A mug with its handle towards +x; two closed solids that overlap where the handle meets the wall."""
    body = lathe([(0, 0), (radius, 0), (radius, height), (radius - wall, height), (radius - wall, wall), (0, wall)])
    angles = np.linspace(-np.pi / 2, np.pi / 2, 25)
    reach, rise = 0.75 * radius, 0.32 * height
    arc = np.stack(
        [radius - wall / 2 + reach * np.cos(angles), np.zeros(25), height / 2 + rise * np.sin(angles)], axis=1
    )
    return Mesh.joined([body, sweep(arc, 0.005)]).resting()


def drill() -> Mesh:
    """A cordless drill lying on its side: motor, grip, battery, chuck and bit; closed solids that overlap."""
    forward = rotation_from_vector([0.0, np.pi / 2, 0.0])

    def lay(part: Mesh, x: float, y: float, z: float) -> Mesh:
        return part.moved(Pose.of(forward, [x, y, z]))

    def slab(length: float, depth: float, thickness: float, x: float, y: float, z: float, turn: float = 0.0) -> Mesh:
        return box(length, depth, thickness).moved(Pose.from_rotation_vector([0, 0, turn], [x, y, z]))

    axis = 0.031
    return Mesh.joined(
        [
            lay(can(0.030, 0.115), -0.075, 0.05, axis),
            lay(lathe([(0, 0), (0.024, 0), (0.015, 0.045), (0, 0.045)]), 0.038, 0.05, axis),
            lay(lathe([(0, 0), (0.0035, 0), (0.0035, 0.05), (0, 0.05)], 16), 0.08, 0.05, axis),
            slab(0.042, 0.11, 0.036, -0.035, -0.02, axis - 0.018, 0.2),
            slab(0.095, 0.042, 0.062, -0.03, -0.085, 0.0),
        ]
    ).resting()


MAKERS: dict[str, Callable[[], Mesh]] = {
    "box": box,
    "can": can,
    "bottle": bottle,
    "bowl": bowl,
    "mug": mug,
    "drill": drill,
}
"""The objects by name."""
