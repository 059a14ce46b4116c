"""Neighbours of an object on its table: other things in resting poses, near it but not touching, some of them in front.

Where things stand is drawn by their outlines, the convex hulls of what they cover of the table.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from pretouch.errors import InvalidInput
from pretouch.geometry import Array, Pose
from pretouch_simulation.depth_cameras.rendering import SHAPE
from pretouch_simulation.mesh import Mesh
from pretouch_simulation.protocol import CAMERA, TABLE
from pretouch_simulation.world import Body, World

NEIGHBOURS = (2, 5)
"""How many there are."""
GAP = (0.02, 0.08)
"""m between the outlines of the object and of a neighbour; in frames of YCB-Video it is 2 to 4.5 cm."""
CLEARANCE = 0.01
"""m: the least between the outlines of two neighbours."""
VISIBLE = 0.5
"""Share of the object's pixels that its neighbours leave visible, at least."""
_SPOTS = 8
"""Places that are tried for each neighbour."""
_STRIDE = 3
"""px between the rays that tell how much of the object is visible."""
_ANGLES = np.linspace(-np.pi, np.pi, 360, endpoint=False)
_DIRECTIONS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)


class _Sight:
    """The rays of the camera at `base_T_camera` that meet `target`, and how much its neighbours hide of it."""

    def __init__(self, target: Body, base_T_camera: Pose) -> None:
        v, u = (index.ravel() for index in np.mgrid[0 : SHAPE[0] : _STRIDE, 0 : SHAPE[1] : _STRIDE])
        ways = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(len(u))], axis=1)
        rays = base_T_camera.rotate(ways)
        hits = World([target], TABLE).trace(np.broadcast_to(base_T_camera.translation, rays.shape), rays)
        met = hits.bodies == 0
        self._origin, self._rays, self._distances = base_T_camera.translation, rays[met], hits.distances[met]
        self.open = np.ones(len(self._rays), dtype=np.bool_)

    def left_by(self, body: Body) -> NDArray[np.bool_]:
        """(n,): the rays that still meet the target where `body` stands there too."""
        origins = np.broadcast_to(self._origin, self._rays.shape)
        return np.asarray(self.open & (World([body], TABLE).cast(origins, self._rays) >= self._distances - 1e-6))


def place_neighbours(
    things: Iterable[Sequence[Mesh]], rng: np.random.Generator, target: Body, base_T_camera: Pose
) -> list[Body]:
    """Two to five of `things` around `target`, each in one of its resting poses, meshes on z = 0.

    The first that fit are taken. The camera at `base_T_camera` sees at least half of the target's pixels past them.

    Raises:
        InvalidInput: fewer than two fit.
    """
    wanted = int(rng.integers(NEIGHBOURS[0], NEIGHBOURS[1], endpoint=True))
    sight = _Sight(target, base_T_camera)
    placed: list[Body] = []
    for poses in things:
        resting = poses[int(rng.integers(len(poses)))]
        for _ in range(_SPOTS):
            body = _put_beside(target, resting, rng)
            left = sight.left_by(body)
            if left.mean() >= VISIBLE and all(gap_between(body, other) >= CLEARANCE for other in placed):
                placed.append(body)
                sight.open = left
                break
        if len(placed) == wanted:
            break
    if len(placed) < NEIGHBOURS[0]:
        raise InvalidInput("Too few things fit beside the object.", "Give a folder of more, or smaller, meshes.")
    return placed


def gap_between(a: Body, b: Body) -> float:
    """m between the outlines of two bodies on the table; negative where they overlap.

    It is the largest separation over the directions of the plane, which for convex sets that are apart is their
    distance.
    """
    return float((-_reach(b, -_DIRECTIONS) - _reach(a, _DIRECTIONS)).max())


def _put_beside(target: Body, resting: Mesh, rng: np.random.Generator) -> Body:
    """`resting`, turned at random, in a random direction from the target, at a gap drawn from GAP."""
    turn, angle, gap = rng.uniform(-np.pi, np.pi), rng.uniform(-np.pi, np.pi), rng.uniform(*GAP)
    centre = np.array([*target.base_T_mesh.translation[:2], 0.0])
    way = np.array([np.cos(angle), np.sin(angle)])
    beside = Body(resting, Pose.from_rotation_vector([0.0, 0.0, turn], centre))
    missing = gap + _reach(target, _DIRECTIONS) + _reach(beside, -_DIRECTIONS)
    speed = _DIRECTIONS @ way
    ahead = speed > 1e-3
    distance = float((missing[ahead] / speed[ahead]).min())
    return Body(resting, Pose.from_rotation_vector([0.0, 0.0, turn], centre + distance * np.array([*way, 0.0])))


def _reach(body: Body, directions: Array) -> Array:
    """(k,), m: how far the body's outline extends in each of `directions` (k, 2)."""
    points = body.base_T_mesh.apply(body.mesh.vertices)[:, :2]
    outline = points[ConvexHull(points).vertices]
    return np.asarray((directions @ outline.T).max(axis=1))
