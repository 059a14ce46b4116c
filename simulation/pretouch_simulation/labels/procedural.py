"""Household objects made in code, with random sizes, for training without mesh files."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pretouch.geometry import Pose
from pretouch_simulation.mesh import Mesh
from pretouch_simulation.objects import bottle, bowl, box, can, lathe, mug


def make_procedural(number: int) -> tuple[str, Mesh]:
    """Makes the object of that number, the same on every machine: its kind, and the mesh, m, z up, on z = 0."""
    make = tuple(_KINDS.values())[number % len(_KINDS)]
    return procedural_name(number), make(np.random.default_rng(number)).resting()


def procedural_name(number: int) -> str:
    """What the object of that number is called."""
    return f"{tuple(_KINDS)[number % len(_KINDS)]}_{number:03d}"


def _box(rng: np.random.Generator) -> Mesh:
    return box(*rng.uniform([0.03, 0.03, 0.01], [0.16, 0.12, 0.16]))


def _can(rng: np.random.Generator) -> Mesh:
    return can(rng.uniform(0.02, 0.05), rng.uniform(0.03, 0.16))


def _bottle(rng: np.random.Generator) -> Mesh:
    return bottle(rng.uniform(0.025, 0.045), rng.uniform(0.12, 0.24))


def _bowl(rng: np.random.Generator) -> Mesh:
    radius = rng.uniform(0.05, 0.1)
    return bowl(radius, radius * rng.uniform(0.4, 0.9), rng.uniform(0.003, 0.008))


def _mug(rng: np.random.Generator) -> Mesh:
    return mug(rng.uniform(0.03, 0.05), rng.uniform(0.06, 0.12), rng.uniform(0.003, 0.006))


def _vase(rng: np.random.Generator) -> Mesh:
    """A solid of revolution with a random outline."""
    heights = np.linspace(0.0, rng.uniform(0.05, 0.2), 7)
    radii = np.clip(np.cumsum(np.r_[rng.uniform(0.02, 0.045), rng.normal(0.0, 0.009, 6)]), 0.01, 0.07)
    return lathe([(0, 0), *zip(radii, heights, strict=True), (0, heights[-1])])


def _blocks(rng: np.random.Generator) -> Mesh:
    """Two to four boxes that stand in each other: corners, steps and gaps."""
    parts = []
    for _ in range(rng.integers(2, 5)):
        part = box(*rng.uniform([0.03, 0.015, 0.01], [0.12, 0.05, 0.09]))
        place = Pose.from_rotation_vector([0.0, 0.0, rng.uniform(-np.pi, np.pi)], [*rng.uniform(-0.025, 0.025, 2), 0.0])
        parts.append(part.moved(place))
    return Mesh.joined(parts)


def _tool(rng: np.random.Generator) -> Mesh:
    """A long handle, lying, with a head across it."""
    length, height = rng.uniform(0.1, 0.2), rng.uniform(0.015, 0.035)
    head = box(*rng.uniform([0.02, 0.05, height], [0.05, 0.11, 1.5 * height]))
    return Mesh.joined([box(length, rng.uniform(0.015, 0.035), height), head.moved(_shift_along_x(length / 2))])


def _shift_along_x(x: float) -> Pose:
    return Pose.from_rotation_vector([0.0, 0.0, 0.0], [x, 0.0, 0.0])


_KINDS: dict[str, Callable[[np.random.Generator], Mesh]] = {
    "box": _box,
    "can": _can,
    "bottle": _bottle,
    "bowl": _bowl,
    "mug": _mug,
    "vase": _vase,
    "blocks": _blocks,
    "tool": _tool,
}
