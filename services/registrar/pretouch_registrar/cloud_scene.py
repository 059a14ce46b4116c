"""Renders a cloud of an object as a scene, by a virtual camera where the real one stood."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from pretouch.camera import Camera, DepthImage
from pretouch.errors import InvalidInput
from pretouch.geometry import Array, Plane, Pose
from pretouch.scene import MIN_OBJECT_PIXELS, Scene

MAX_CLOUD = 1_000_000
"""Points; the image could not hold the detail of more."""
_VIEWPOINT_HEIGHT = 3.0
"""m above the object: the viewpoint of a cloud whose own is not known."""
_MARGIN = 0.1
"""m of table around the object."""
_PIXEL_SPACINGS = 1.5
"""Side of a pixel, in median distances between neighbouring points, so that few pixels inside the object are empty."""
_MIN_PIXEL = 0.0005
_MAX_PIXELS_ACROSS = 700
_SPACING_SAMPLE = 2000
_MIN_DISTANCE = 0.05
"""m from the viewpoint to the nearest point, along the view."""


def thin_cloud(cloud: Array, most: int) -> Array:
    """At most `most` rows of `cloud` (n, 3), evenly over their order."""
    if len(cloud) <= most:
        return cloud
    return cloud[np.linspace(0, len(cloud) - 1, most).astype(np.int64)]


def find_table_below(cloud: Array) -> Plane:
    """The horizontal plane, base z up, at the cloud's lowest points: one in two hundred lies below it."""
    return Plane(np.array([0.0, 0.0, 1.0]), float(np.quantile(cloud[:, 2], 0.005)))


def cloud_scene(cloud: Array, table: Plane, viewpoint: Array | None) -> Scene:
    """A depth image of `cloud` (n, 3), m, in base, all of it the object's; the table fills the rest.

    Args:
        viewpoint: (3,), m, in base, where the camera was; None looks straight down from far above.

    Raises:
        InvalidInput: too few points, or a viewpoint among them or below the table.
    """
    points = thin_cloud(cloud, MAX_CLOUD)
    distinct = len(np.unique(thin_cloud(points, _SPACING_SAMPLE), axis=0))
    if distinct < MIN_OBJECT_PIXELS:
        raise InvalidInput(
            f"The target has {distinct} distinct points; at least {MIN_OBJECT_PIXELS} are needed.",
            "Give the object's whole cloud as the camera sees it.",
        )
    middle = points.mean(axis=0)
    eye = middle + _VIEWPOINT_HEIGHT * table.normal if viewpoint is None else np.asarray(viewpoint, dtype=np.float64)
    if table.height(eye) <= 0:
        raise InvalidInput(
            f"The viewpoint {np.round(eye, 3).tolist()} is not above the table.", "Check viewpoint and table: base, m."
        )
    base_T_camera = _look_at(eye, middle, table)
    seen = base_T_camera.inverse().apply(points)
    if seen[:, 2].min() < _MIN_DISTANCE:
        raise InvalidInput(
            f"The viewpoint {np.round(eye, 3).tolist()} lies among the target's points, or they surround it.",
            "Give the camera's position in base, m, and the object's cloud alone.",
        )
    camera, shape = _fit_camera(points, seen)
    depth = _project_nearest(camera.project(seen), seen[:, 2], shape)
    mask = depth > 0
    return Scene(
        DepthImage(np.where(mask, depth, _render_table(camera, base_T_camera, table, shape)).astype(np.float32)),
        camera,
        base_T_camera,
        mask,
        table,
    )


def _look_at(eye: Array, at: Array, table: Plane) -> Pose:
    """`base_T_camera` of a camera at `eye` that looks at a point."""
    z = (at - eye) / max(float(np.linalg.norm(at - eye)), 1e-9)
    axes = table.frame().rotation
    x = np.cross(z, table.normal)
    x = x / np.linalg.norm(x) if np.linalg.norm(x) > 1e-3 else axes[:, 0] - z * (z @ axes[:, 0])
    x = x / np.linalg.norm(x)
    return Pose.of(np.stack([x, np.cross(z, x), z], axis=1), eye)


def _fit_camera(cloud: Array, seen: Array) -> tuple[Camera, tuple[int, int]]:
    """Intrinsics whose pixels are a bit larger than the points' spacing, and the image's (h, w)."""
    sample = cloud[:: -(-len(cloud) // _SPACING_SAMPLE)]
    spacing = float(np.median(cKDTree(cloud).query(sample, k=2)[0][:, 1]))
    rays = seen[:, :2] / seen[:, 2:]
    distance = float(np.median(seen[:, 2]))
    low, high = rays.min(axis=0) - _MARGIN / distance, rays.max(axis=0) + _MARGIN / distance
    pixel = max(
        _PIXEL_SPACINGS * spacing / distance, _MIN_PIXEL / distance, float((high - low).max()) / _MAX_PIXELS_ACROSS
    )
    width, height = (int(n) for n in np.ceil((high - low) / pixel) + 1)
    return Camera(1 / pixel, 1 / pixel, -low[0] / pixel, -low[1] / pixel), (height, width)


def _project_nearest(pixels: Array, depths: Array, shape: tuple[int, int]) -> Array:
    """A depth image (h, w): the nearest point of each pixel; small holes take their nearest neighbour's."""
    u, v = np.rint(pixels).astype(np.int64).T
    image = np.full(shape, np.inf)
    np.minimum.at(image, (v.clip(0, shape[0] - 1), u.clip(0, shape[1] - 1)), depths)
    filled = np.isfinite(image)
    closed: NDArray[np.bool_] = ndimage.binary_closing(filled, np.ones((3, 3), dtype=bool))
    nearest = ndimage.distance_transform_edt(~filled, return_distances=False, return_indices=True)
    return np.asarray(np.where(closed | filled, image[tuple(nearest)], 0.0), dtype=np.float64)


def _render_table(camera: Camera, base_T_camera: Pose, table: Plane, shape: tuple[int, int]) -> Array:
    """(h, w): depth of the table behind each pixel, 0 where there is none."""
    rays = base_T_camera.rotate(camera.back_project_image(np.ones(shape)))
    approach = -(rays @ table.normal)
    height = float(table.height(base_T_camera.translation))
    return np.asarray(np.where(approach > 1e-3, height / np.maximum(approach, 1e-3), 0.0), dtype=np.float64)
