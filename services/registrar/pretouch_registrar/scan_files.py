"""What `pretouch scan register` reads: targets, and what the finger measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pretouch.camera import Camera, DepthImage
from pretouch.errors import InvalidInput
from pretouch.geometry import Plane, Pose
from pretouch.mesh_target import MAX_EXTENT, MeshTarget
from pretouch.scene import Scene
from pretouch.tof import MAX_SAMPLES, Scan
from pretouch_registrar.cloud_scene import MAX_CLOUD, cloud_scene, find_table_below, thin_cloud
from pretouch_registrar.files import read_shape
from pretouch_registrar.files.npz import NpzFile
from pretouch_registrar.files.shape import check_size
from pretouch_registrar.mesh_scene import mesh_scene

Say = Callable[[str], None]
"""Takes what a user should know: what was left out, what was taken for granted."""
_LARGEST = 2.0
"""m: of an object that a camera sees on a table."""
_CROP = 0.1
"""m around the object that a depth image is cut to."""


@dataclass(frozen=True, eq=False)
class Given:
    """What the command line says of the target; None where it says nothing."""

    table: Plane | None = None
    viewpoint: Sequence[float] | None = None
    base_T_object: Pose | None = None


def read_target(path: Path, given: Given, say: Say) -> Scene:
    """The scene of a depth image (.npz), a cloud or a mesh.

    Raises:
        NotFound, Malformed, InvalidInput, TooLarge: see the message.
    """
    if path.suffix.lower() == ".npz":
        file = NpzFile(path)
        if "depth" in file:
            return _depth_scene(file, given, say)
        return _scene_of_points(path.name, file.numbers("points", (None, 3)), given, given.viewpoint, say)
    shape = read_shape(path)
    for remark in shape.remarks:
        say(f"{path.name}: {remark}")
    if shape.faces is not None:
        check_size(path.name, shape.points[shape.faces].reshape(-1, 3), MAX_EXTENT)
        pose = given.base_T_object or Pose.identity()
        table = given.table or _announce_table(path.name, find_table_below(pose.apply(shape.points)), say)
        return mesh_scene(MeshTarget(shape.points, shape.faces, pose, table))
    if given.base_T_object is not None:
        raise InvalidInput(f"{path.name} has no triangles, so --object-pose means nothing.", "Leave it out.")
    viewpoint = given.viewpoint if given.viewpoint is not None else shape.viewpoint
    return _scene_of_points(path.name, shape.points, given, viewpoint, say)


def read_scan(path: Path, table: Plane, say: Say) -> Scan:
    """One scan: beams (.npz with origins, directions and ranges, NaN for a miss), or points of any file.

    Points are taken to have been seen along the table's normal. More than MAX_SAMPLES are thinned out.

    Raises:
        NotFound, Malformed, InvalidInput: see the message.
    """
    if path.suffix.lower() == ".npz":
        file = NpzFile(path)
        if "ranges" in file:
            beams = [file.array(key) for key in ("origins", "directions", "ranges")]
            if any(np.ndim(values) == 0 for values in beams) or len({len(values) for values in beams}) > 1:
                raise InvalidInput(
                    f"{path.name}: origins, directions and ranges are not equally many.", "Write one of each a beam."
                )
            kept = _choose_samples(path.name, len(beams[2]), say)
            scan = Scan(*(values[kept] for values in beams))
            check_size(path.name, scan.origins, MAX_EXTENT)
            return scan
        points = file.numbers("points", (None, 3))
    else:
        shape = read_shape(path)
        for remark in shape.remarks:
            say(f"{path.name}: {remark}")
        points = shape.points
    check_size(path.name, points, MAX_EXTENT)
    return Scan.of_points(points[_choose_samples(path.name, len(points), say)], -table.normal)


def _choose_samples(name: str, count: int, say: Say) -> NDArray[np.int64]:
    if count > MAX_SAMPLES:
        say(f"{name}: {count} samples were thinned out to {MAX_SAMPLES}.")
    return np.linspace(0, count - 1, min(count, MAX_SAMPLES)).astype(np.int64)


def _scene_of_points(
    name: str, points: NDArray[np.float64], given: Given, viewpoint: Sequence[float] | NDArray[Any] | None, say: Say
) -> Scene:
    if len(points) > MAX_CLOUD:
        say(f"{name}: {len(points)} points were thinned out to {MAX_CLOUD}.")
    cloud = thin_cloud(points, MAX_CLOUD)
    check_size(name, cloud, _LARGEST)
    table = given.table or _announce_table(name, find_table_below(cloud), say)
    if viewpoint is None:
        say(f"{name}: no viewpoint is known, so it is looked at from straight above; --viewpoint gives the camera's.")
    scene = cloud_scene(cloud, table, None if viewpoint is None else np.asarray(viewpoint, dtype=np.float64))
    _check_table(name, scene)
    return scene


def _announce_table(name: str, table: Plane, say: Say) -> Plane:
    say(f"{name}: the table is taken to be level at its lowest points, z = {table.offset:.4f} m; --table gives it.")
    return table


def _depth_scene(file: NpzFile, given: Given, say: Say) -> Scene:
    depth = file.array("depth")
    table = given.table
    if table is None and "table" in file:
        normal_offset = file.numbers("table", (4,))
        table = Plane(normal_offset[:3], float(normal_offset[3]))
    stored = depth.astype(np.float32) if depth.dtype.kind == "f" else depth
    scene = Scene(
        DepthImage.from_values(stored, 1.0 if depth.dtype.kind == "f" else file.number("depth_scale")),
        Camera(file.number("fx"), file.number("fy"), file.number("cx"), file.number("cy")),
        Pose(file.numbers("base_T_camera", (4, 4))),
        file.array("mask", "biuf") != 0,
        table or Plane(np.array([0.0, 0.0, 1.0]), 0.0),
    )
    check_size(file.name, scene.cloud, _LARGEST)
    if table is None:
        scene = replace(scene, table=_announce_table(file.name, find_table_below(scene.cloud), say))
    _check_table(file.name, scene)
    return scene.cropped(_CROP)[0]


def _check_table(name: str, scene: Scene) -> None:
    """Raises InvalidInput if the table's plane has the camera or the whole object behind it."""
    remedy = "Give the table as a unit normal that points away from it, towards the camera, and its offset: base, m."
    if scene.table.height(scene.base_T_camera.translation) <= 0:
        raise InvalidInput(f"{name}: the table's normal does not point to the camera's side.", remedy)
    if scene.table.height(scene.cloud).max() < 0:
        raise InvalidInput(f"{name}: nothing of the object stands above the table.", remedy)
