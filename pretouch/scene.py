"""What the camera saw: a depth image, the object's mask and the table, all as the camera puts them in base."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pretouch.camera import Camera, DepthImage
from pretouch.errors import InvalidInput
from pretouch.geometry import MAX_DISTANCE, Array, Plane, Pose, frozen_array

MIN_OBJECT_PIXELS = 50
SCAN_MARGIN = 0.015
"""m around the object, in the table's plane, that scans cover; farther away they give little information."""
TABLE_BAND = 0.015
"""m from the table's plane within which a pixel beside the object shows the table."""


@dataclass(frozen=True, eq=False)
class Scene:
    """One view of an object on a table.

    Attributes:
        depth: the depth image, (h, w).
        camera: its intrinsics.
        base_T_camera: the extrinsics as the client believes them; their error is what is estimated.
        mask: (h, w) bool, True on the object; kept only where there is depth.
        table: in base by `base_T_camera`, normal away from the table.

    Raises:
        InvalidInput: camera or table is farther from base than MAX_DISTANCE, the mask's size is not the image's, or it
            holds fewer than MIN_OBJECT_PIXELS pixels with depth.
    """

    depth: DepthImage
    camera: Camera
    base_T_camera: Pose
    mask: NDArray[np.bool_]
    table: Plane

    def __post_init__(self) -> None:
        frozen_array(self.base_T_camera.translation, (3,), "base_T_camera", MAX_DISTANCE)
        frozen_array(self.table.offset, (), "table.offset", MAX_DISTANCE)
        mask = np.array(self.mask, dtype=bool)
        if mask.shape != self.depth.metres.shape:
            raise InvalidInput(
                f"The mask is {list(mask.shape)} pixels (h, w), the depth image {list(self.depth.metres.shape)}.",
                "Send a mask of the depth image's size.",
            )
        mask &= self.depth.metres > 0
        if mask.sum() < MIN_OBJECT_PIXELS:
            raise InvalidInput(
                f"The object has {int(mask.sum())} pixels with depth; at least {MIN_OBJECT_PIXELS} are needed.",
                "Check mask, roi and table, and that the camera sees the object.",
            )
        mask.setflags(write=False)
        object.__setattr__(self, "mask", mask)

    @cached_property
    def organised(self) -> Array:
        """(h, w, 3), m, in base: every pixel's point; meaningless where `depth` is 0."""
        return self.base_T_camera.apply(self.camera.back_project_image(self.depth.metres))

    @cached_property
    def cloud(self) -> Array:
        """(n, 3), m, in base: the object's points, before correction."""
        v, u = np.nonzero(self.mask)
        points = self.camera.back_project(np.stack([u, v], axis=-1), self.depth.metres[self.mask])
        return self.base_T_camera.apply(points)

    @cached_property
    def centroid(self) -> Array:
        """(3,), m, in base: the mean of `cloud`."""
        return np.asarray(self.cloud.mean(axis=0), dtype=np.float64)

    @cached_property
    def radius(self) -> float:
        """m: root mean square distance of `cloud` from `centroid`."""
        return float(np.sqrt(((self.cloud - self.centroid) ** 2).sum(axis=1).mean()))

    @cached_property
    def digest(self) -> bytes:
        """(32,) SHA-256 of the content: equal for scenes that are equal to the bit, in whatever process."""
        digest = hashlib.sha256(np.ascontiguousarray(self.depth.metres).tobytes())
        digest.update(np.packbits(self.mask).tobytes())
        c, table = self.camera, self.table
        numbers = [*self.depth.metres.shape, c.fx, c.fy, c.cx, c.cy, *self.base_T_camera.matrix.ravel()]
        digest.update(np.array([*numbers, *table.normal, table.offset], dtype="<f8").tobytes())
        return digest.digest()

    def moved(self, correction: Pose) -> Scene:
        """The same view where `correction`, from base to base, puts camera, object and table."""
        return Scene(self.depth, self.camera, correction @ self.base_T_camera, self.mask, self.table.moved(correction))

    def bounds(self) -> tuple[int, int, int, int]:
        """The mask's bounding box (u0, v0, u1, v1), half-open."""
        u, v = (np.flatnonzero(self.mask.any(axis=axis)) for axis in (0, 1))
        return int(u[0]), int(v[0]), int(u[-1]) + 1, int(v[-1]) + 1

    def subsampled(self, step: int) -> Scene:
        """The view of every `step`-th pixel in each direction, the first one kept."""
        if step == 1:
            return self
        window = np.s_[::step, ::step]
        return Scene(
            DepthImage(self.depth.metres[window]),
            self.camera.subsampled(step),
            self.base_T_camera,
            self.mask[window],
            self.table,
        )

    def cropped(self, margin: float) -> tuple[Scene, tuple[int, int]]:
        """The view within `margin` metres of the object, at its depth, and that view's first pixel (u0, v0)."""
        z = float(np.median(self.depth.metres[self.mask]))
        pad_u, pad_v = (int(np.ceil(margin * f / z)) for f in (self.camera.fx, self.camera.fy))
        u0, v0, u1, v1 = self.bounds()
        u0, v0 = max(0, u0 - pad_u), max(0, v0 - pad_v)
        window = np.s_[v0 : v1 + pad_v, u0 : u1 + pad_u]
        scene = Scene(
            DepthImage(self.depth.metres[window]),
            self.camera.cropped(u0, v0),
            self.base_T_camera,
            self.mask[window],
            self.table,
        )
        return scene, (u0, v0)
