"""The interface of the simulated depth cameras, and the ray casting that they share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pretouch.camera import Camera, DepthImage
from pretouch.geometry import Array, Pose
from pretouch_simulation.world import World

SHAPE = (480, 640)
_SHADOW_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class Rendering:
    """One image of a world.

    Attributes:
        depth: as the camera measures it.
        bodies: (h, w), the index of the body that each pixel's ray truly meets, `TABLE` or `NOTHING`.
        mask: (h, w) bool, where a client takes body 0 to be and there is a depth; it need not fit either of the above.
    """

    depth: DepthImage
    bodies: NDArray[np.int64]
    mask: NDArray[np.bool_]


class DepthCamera(Protocol):
    """A camera with all its parameters."""

    def render(
        self,
        world: World,
        camera: Camera,
        base_T_camera: Pose,
        rng: np.random.Generator,
        shape: tuple[int, int] = SHAPE,
    ) -> Rendering:
        """The image of `world` from `base_T_camera`, `shape` = (h, w); `rng` draws the errors of this image."""


class Sight(NamedTuple):
    """What the rays of an image truly meet.

    Attributes:
        depth: (h, w), m along the optical axis; 0 = nothing.
        lit: (h, w) bool, whether the projector, or the second imager, reaches the point as well.
        incidence: (h, w), rad, between the surface's normal and the ray.
        bodies: (h, w), as in `Rendering`.
    """

    depth: Array
    lit: NDArray[np.bool_]
    incidence: Array
    bodies: NDArray[np.int64]


def look(world: World, camera: Camera, base_T_camera: Pose, shape: tuple[int, int], baseline: float) -> Sight:
    """Casts the rays of an image, and those from a second place `baseline`, m, to the camera's right."""
    v, u = np.indices(shape)
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(shape)], axis=-1).reshape(-1, 3)
    ways = base_T_camera.rotate(rays)
    hits = world.trace(np.broadcast_to(base_T_camera.translation, rays.shape), ways)
    true = hits.distances.reshape(shape)
    seen = np.isfinite(true) & (true > 0)
    lit = seen.copy()
    lit[seen] = _lit(world, base_T_camera, rays[seen.ravel()] * true[seen][:, None], baseline)
    cosine = np.abs(np.einsum("ij,ij->i", hits.normals, ways)) / np.linalg.norm(ways, axis=1)
    incidence = np.arccos(np.clip(cosine, 0.0, 1.0)).reshape(shape)
    return Sight(np.where(seen, true, 0.0), lit, incidence, hits.bodies.reshape(shape))


def _lit(world: World, base_T_camera: Pose, points: Array, baseline: float) -> NDArray[np.bool_]:
    """(n,) whether `points` (n, 3), given in the camera frame, are reached from the second place."""
    projector = np.array([baseline, 0.0, 0.0])
    origins = np.broadcast_to(base_T_camera.apply(projector), points.shape)
    reached = world.cast(origins, base_T_camera.rotate(points - projector))
    return np.asarray(reached > 1.0 - _SHADOW_TOLERANCE, dtype=np.bool_)
