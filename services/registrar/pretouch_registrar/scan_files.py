"""What `pretouch scan register` reads: targets, and what the finger measured."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from pretouch.camera import Camera, DepthImage
from pretouch.errors import InvalidInput, Malformed
from pretouch.geometry import Plane, Pose, frozen_array
from pretouch.mesh_target import MAX_EXTENT, MeshTarget
from pretouch.scene import Scene
from pretouch.tof import MAX_SAMPLES, Scan
from pretouch_registrar.cloud_scene import MAX_CLOUD, cloud_scene, find_table_below, thin_cloud
from pretouch_registrar.files import read_shape
from pretouch_registrar.files.content import read_bytes
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
        arrays = _arrays(path)
        if "depth" in arrays:
            return _depth_scene(path.name, arrays, given, say)
        points = frozen_array(_member(path.name, arrays, "points"), (None, 3), f"{path.name}: points")
        return _scene_of_points(path.name, points, given, given.viewpoint, say)
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
        arrays = _arrays(path)
        if "ranges" in arrays:
            beams = [_member(path.name, arrays, name) for name in ("origins", "directions", "ranges")]
            if any(np.ndim(values) == 0 for values in beams) or len({len(values) for values in beams}) > 1:
                raise InvalidInput(
                    f"{path.name}: origins, directions and ranges are not equally many.", "Write one of each a beam."
                )
            kept = _choose_samples(path.name, len(beams[2]), say)
            scan = Scan(*(values[kept] for values in beams))
            check_size(path.name, scan.origins, MAX_EXTENT)
            return scan
        points = frozen_array(_member(path.name, arrays, "points"), (None, 3), f"{path.name}: points")
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
    return cloud_scene(cloud, table, None if viewpoint is None else np.asarray(viewpoint, dtype=np.float64))


def _announce_table(name: str, table: Plane, say: Say) -> Plane:
    say(f"{name}: the table is taken to be level at its lowest points, z = {table.offset:.4f} m; --table gives it.")
    return table


def _depth_scene(name: str, arrays: dict[str, NDArray[Any]], given: Given, say: Say) -> Scene:
    depth = _member(name, arrays, "depth")

    def number(key: str) -> float:
        return float(frozen_array(_member(name, arrays, key), (), f"{name}: {key}"))

    table = given.table
    if table is None and "table" in arrays:
        normal_offset = frozen_array(arrays["table"], (4,), f"{name}: table")
        table = Plane(normal_offset[:3], float(normal_offset[3]))
    stored = depth.astype(np.float32) if depth.dtype.kind == "f" else depth
    scene = Scene(
        DepthImage.from_values(stored, 1.0 if depth.dtype.kind == "f" else number("depth_scale")),
        Camera(number("fx"), number("fy"), number("cx"), number("cy")),
        Pose(frozen_array(_member(name, arrays, "base_T_camera"), (4, 4), f"{name}: base_T_camera")),
        _member(name, arrays, "mask") != 0,
        table or Plane(np.array([0.0, 0.0, 1.0]), 0.0),
    )
    check_size(name, scene.cloud, _LARGEST)
    if table is None:
        scene = replace(scene, table=_announce_table(name, find_table_below(scene.cloud), say))
    return scene.cropped(_CROP)[0]


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    """All arrays of an .npz file; never unpickled."""
    try:
        loaded = np.load(io.BytesIO(read_bytes(path)), allow_pickle=False)
        return {key: loaded[key] for key in loaded.files}
    except (ValueError, OSError, EOFError, BadZipFile, AttributeError, MemoryError, OverflowError) as error:
        raise Malformed(f"{path.name} is not a readable .npz file.", "Write it with numpy.savez.") from error


def _member(name: str, arrays: dict[str, NDArray[Any]], key: str) -> NDArray[Any]:
    if key not in arrays:
        found = ", ".join(sorted(arrays)) or "nothing"
        raise InvalidInput(
            f"{name} holds {found}, but no {key}.",
            "Write a target as depth, fx, fy, cx, cy, base_T_camera and mask, with depth_scale where depth is not in "
            "metres and table [nx, ny, nz, d] where it is known, or as points; a scan as origins, directions and "
            "ranges, or as points.",
        )
    return arrays[key]
