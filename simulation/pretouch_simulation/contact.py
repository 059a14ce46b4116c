"""How near a finger comes to the world: an upright cylinder about the beam whose flat end is the tip."""

from __future__ import annotations

import numpy as np
from pretouch_orchestrator.planning.tip_floor import FINGER_RADIUS

from pretouch.geometry import Array
from pretouch_simulation.world import World

_SPACING = 0.002
"""m between the poses at which the distance is taken."""
_LENGTH = 0.5
"""m: the finger's length above its tip, and the arm's that carries it."""
_RINGS = 5


def measure_clearance(world: World, base_T_tip: Array) -> float:
    """The least distance of the fingertip's end from the world on its way through the poses (n, 4, 4), in m.

    It is measured along the beam, everywhere over the end's disc of FINGER_RADIUS; negative where something reaches
    into the finger. The ways down to the first pose and up from the last, along the beam, are within it.
    """
    poses = _interpolate(base_T_tip)
    disc = _cover_disc()
    up = -poses[:, :3, 2]
    ends = poses[:, None, :3, 3] + np.einsum("nij,kj->nki", poses[:, :3, :2], disc)
    starts = (ends + _LENGTH * up[:, None]).reshape(-1, 3)
    distances = world.cast(starts, np.repeat(-up, len(disc), axis=0))
    return float(distances.min()) - _LENGTH


def _interpolate(base_T_tip: Array) -> Array:
    """Poses at most _SPACING apart on straight lines through those given, which do not turn."""
    steps = np.linalg.norm(np.diff(base_T_tip[:, :3, 3], axis=0), axis=1)
    travelled = np.insert(np.cumsum(steps), 0, 0.0)
    at = np.linspace(0.0, travelled[-1], int(np.ceil(travelled[-1] / _SPACING)) + 1)
    before = np.clip(np.searchsorted(travelled, at, side="right") - 1, 0, len(base_T_tip) - 1)
    poses = base_T_tip[before].copy()
    for axis in range(3):
        poses[:, axis, 3] = np.interp(at, travelled, base_T_tip[:, axis, 3])
    return poses


def _cover_disc() -> Array:
    """Points (k, 2), m, of the disc: its centre and rings out to its rim, about 2 mm apart."""
    rings = [np.zeros((1, 2))]
    for ring in range(1, _RINGS + 1):
        angles = 2 * np.pi * np.arange(6 * ring) / (6 * ring)
        rings.append(FINGER_RADIUS * ring / _RINGS * np.stack([np.cos(angles), np.sin(angles)], axis=1))
    return np.concatenate(rings)
