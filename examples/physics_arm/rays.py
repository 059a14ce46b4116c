"""The engine's own rays, which camera and finger see by."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from examples.physics_arm.world import World

_FAR = 5.0  # m


def cast(
    world: World, origin: NDArray[np.float64], directions: NDArray[np.float64], ignored_body: str = "world"
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """How far each ray goes, and what it hits.

    Args:
        origin: (3,), m, in base.
        directions: (n, 3), unit, in base.
        ignored_body: a body that the rays pass through; `world` holds the table, so that nothing is ignored.

    Returns:
        Distances (n,), m, NaN where nothing is hit, and geom ids (n,), -1 likewise.
    """
    n = len(directions)
    distances, geoms = np.zeros(n), np.zeros(n, dtype=np.int32)
    excluded = -1 if ignored_body == "world" else world.model.body(ignored_body).id
    mujoco.mj_multiRay(
        world.model, world.data, origin, directions.ravel(), None, True, excluded, geoms, distances, None, n, _FAR
    )
    return np.where(geoms < 0, np.nan, distances), geoms
