"""The errors of a depth image of a known world, measured alike for real images and simulated ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pretouch_simulation.world import World
from scipy import ndimage

from pretouch.camera import Camera
from pretouch.geometry import Array, Pose

NEAR = 0.02
"""m; a depth further than this from the mesh belongs to something else."""
SCALES = (1, 2, 4, 8, 16)
"""px."""
REACH = 20
"""px; profiles end here."""
FAR = 0.04
"""m; a background further behind a silhouette than this counts as far."""
_RIDGE_WINDOW, _RIDGE = 17, 0.002
_MARGIN = 6

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Truth:
    """What an ideal camera would see.

    Attributes:
        depth: (h, w), m; 0 = nothing.
        bodies: (h, w), as `Hits.bodies`.
    """

    depth: Array
    bodies: NDArray[np.int64]


def truth_of(world: World, camera: Camera, base_T_camera: Pose, shape: tuple[int, int]) -> Truth:
    """Casts the rays of the image."""
    v, u = np.indices(shape)
    rays = camera.back_project(np.stack([u, v], axis=-1).reshape(-1, 2), np.ones(u.size))
    hits = world.trace(np.broadcast_to(base_T_camera.translation, rays.shape), base_T_camera.rotate(rays))
    depth = np.where(np.isfinite(hits.distances), hits.distances, 0.0)
    return Truth(depth.reshape(shape), hits.bodies.reshape(shape))


@dataclass(frozen=True, eq=False)
class Residuals:
    """Of one object in one image; lengths in m.

    Attributes:
        pixels: how many have a depth near the mesh.
        mean, std: of the residual, measured minus true.
        smoothed: (5,), its std after smoothing over `SCALES`.
        ridge: (REACH,), mean residual minus that far from ridges, by the distance from a ridge in px; NaN: no pixel.
        missing: (REACH,), share without a depth by the distance from a silhouette before a far background, px.
        eaten: (REACH,), share with the background's depth, the same.
        outlines: (n,), px, of the true outline before a far background from that of the depth image.
        mask_outlines: (m,), px, of the outline of the client's mask, its holes filled, from the true one.
    """

    pixels: int
    mean: float
    std: float
    smoothed: Array
    ridge: Array
    missing: Array
    eaten: Array
    outlines: Array
    mask_outlines: Array


def residuals(truth: Truth, measured: Array, mask: Mask, body: int = 0) -> Residuals:
    """Of the object `body` in the image `measured` (h, w), m, of which a client has `mask` (h, w)."""
    of_object = truth.bodies == body
    residual = measured - truth.depth
    near = of_object & (measured > 0) & (np.abs(residual) < NEAR)
    inside = ndimage.distance_transform_edt(of_object)
    behind = far_silhouette(truth, of_object)
    from_far = np.where(of_object, ndimage.distance_transform_edt(~behind), 0.0)
    values = residual[near]
    return Residuals(
        pixels=int(near.sum()),
        mean=float(values.mean()),
        std=float(values.std()),
        smoothed=np.array([smooth(residual, near, scale)[near].std() for scale in SCALES]),
        ridge=_ridge_profile(truth, of_object, near & (inside > _MARGIN), residual),
        missing=_profile(from_far, of_object, measured == 0),
        eaten=_profile(from_far, of_object, (measured > 0) & (residual > NEAR)),
        outlines=_outlines(truth, of_object, measured),
        mask_outlines=_apart(mask, of_object),
    )


def smooth(values: Array, where: Mask, scale: float) -> Array:
    """(h, w): the mean of `values` weighted by a Gaussian of `scale` px, of those `where` alone."""
    weights = ndimage.gaussian_filter(where.astype(np.float64), scale)
    return np.asarray(ndimage.gaussian_filter(np.where(where, values, 0.0), scale) / np.maximum(weights, 1e-9))


def far_silhouette(truth: Truth, of_object: Mask) -> Mask:
    """(h, w): pixels beside the object whose truth lies `FAR` behind the object's next to them."""
    edge = ndimage.maximum_filter(np.where(of_object, truth.depth, 0.0), 3)
    return np.asarray(~of_object & (edge > 0) & (truth.depth > edge + FAR))


def ridges(truth: Truth, of_object: Mask) -> Mask:
    """(h, w): where the surface lies further before the mean around it than anywhere near, by 2 mm and more."""
    share = ndimage.uniform_filter(of_object.astype(np.float64), _RIDGE_WINDOW)
    mean = ndimage.uniform_filter(np.where(of_object, truth.depth, 0.0), _RIDGE_WINDOW) / np.maximum(share, 1e-9)
    convex = np.where(of_object & (share > 0.99), mean - truth.depth, 0.0)
    return np.asarray((convex > _RIDGE) & (convex >= ndimage.maximum_filter(convex, 5)))


def _ridge_profile(truth: Truth, of_object: Mask, counted: Mask, residual: Array) -> Array:
    ridge = ridges(truth, of_object)
    if not ridge.any():
        return np.full(REACH, np.nan)
    distance = ndimage.distance_transform_edt(~ridge)
    away = counted & (distance >= REACH)
    plain = residual[away].mean() if away.sum() > 50 else np.nan
    return _profile(distance + 1, counted, residual) - plain


def _profile(distance: Array, counted: Mask, values: Array | Mask) -> Array:
    """(REACH,): mean of `values` in rings 1, 2, ... px away; NaN: no pixel there."""
    ring = np.clip(np.rint(distance[counted]).astype(np.int64), 0, REACH + 1)
    count = np.bincount(ring, minlength=REACH + 2)[1 : REACH + 1]
    total = np.bincount(ring, np.asarray(values, dtype=np.float64)[counted], minlength=REACH + 2)[1 : REACH + 1]
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _outlines(truth: Truth, of_object: Mask, measured: Array) -> Array:
    """(n,), px: how far the true outline is from that of the object in the depth image."""
    beside = far_silhouette(truth, of_object)
    band = ndimage.distance_transform_edt(~beside) < REACH
    front = ndimage.maximum_filter(np.where(of_object, truth.depth, 0.0), 2 * REACH + 1)
    seen = (measured > 0) & (measured < np.where(of_object, truth.depth, front) + NEAR) & (of_object | band)
    border = of_object & ndimage.binary_dilation(beside)
    return np.asarray(ndimage.distance_transform_edt(~_outline(seen))[border])


def _apart(mask: Mask, of_object: Mask) -> Array:
    whole = ndimage.binary_fill_holes(ndimage.binary_closing(mask, iterations=3))
    return np.asarray(ndimage.distance_transform_edt(~_outline(of_object))[_outline(whole)])


def _outline(mask: Mask) -> Mask:
    return np.asarray(mask & ~ndimage.binary_erosion(mask))
