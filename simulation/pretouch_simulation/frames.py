"""Real depth frames with ground truth: what a real camera saw, and the world that the finger meets there.

A frame is `<id>.json` with intrinsics, `depth_unit_m`, the names of its depth and label images, and its objects, each
with `name`, `label`, `mesh` and `T_cam_obj`, 4x4, m, camera axes x right, y down, z forward.

Frames without poses can be looked at all the same (`load_images`, `list_labelled`).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pretouch_orchestrator.perception.table import fit_table
from scipy import ndimage

from pretouch.camera import Camera, DepthImage, decode_depth, decode_png
from pretouch.errors import InvalidInput, Malformed, NotFound, PretouchError
from pretouch.geometry import Plane, Pose
from pretouch_simulation.mesh import load_mesh
from pretouch_simulation.protocol import PLACE, Case, draw_hidden_offset, generator
from pretouch_simulation.world import Body, World

_KEYS = ("width", "height", "fx", "fy", "cx", "cy", "depth_unit_m", "files")
_MARGIN = 3
"""px around labelled objects that do not count as table, because depth and labels are misaligned."""


@dataclass(frozen=True, eq=False)
class FrameObject:
    """An object of a frame: its mesh file and where it truly is."""

    name: str
    label: int
    mesh: Path
    camera_T_object: Pose


@dataclass(frozen=True, eq=False)
class Frame:
    """One real view.

    Attributes:
        labels: (h, w), the `label` of the object at each pixel, 0 = none.
        table: in the camera frame, fitted to the depth outside the labels.
    """

    name: str
    depth: DepthImage
    camera: Camera
    labels: NDArray[np.int64]
    objects: tuple[FrameObject, ...]
    table: Plane

    def object(self, name: str) -> FrameObject:
        """The object called `name`; raises `NotFound`, naming those that are there."""
        for candidate in self.objects:
            if candidate.name == name:
                return candidate
        names = ", ".join(candidate.name for candidate in self.objects)
        raise NotFound(f"The frame {self.name} has no object {name!r}.", f"Choose from: {names}.")

    def mask(self, name: str) -> NDArray[np.bool_]:
        """(h, w): the object's pixels with a depth."""
        return np.asarray((self.labels == self.object(name).label) & (self.depth.metres > 0), dtype=np.bool_)


@dataclass(frozen=True, eq=False)
class FrameImages:
    """What the camera gave, of any frame.

    Attributes:
        labels: (h, w), which object is at each pixel, 0 = none; None where the frame has no label image.
    """

    depth: DepthImage
    camera: Camera
    labels: NDArray[np.int64] | None


def load_images(path: Path) -> FrameImages:
    """Reads a frame's images and intrinsics.

    Raises:
        NotFound: the file, or one that it names, does not exist.
        Malformed: it cannot be read.
        InvalidInput: its images do not fit each other.
    """
    description = _description(path)
    try:
        camera = Camera(*(description[key] for key in ("fx", "fy", "cx", "cy")))
        values = decode_depth(_file(path, description["files"]["depth"]).read_bytes())
        named = description["files"].get("label")
        labels = None
        if named is not None:
            labels = decode_png(_file(path, named).read_bytes(), "label image").astype(np.int64)
        shape = (int(description["height"]), int(description["width"]))
        depth = DepthImage.from_values(values, description["depth_unit_m"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _explain_misuse(path, error) from error
    if depth.metres.shape != shape or (labels is not None and labels.shape != shape):
        given = "" if labels is None else f", labels {list(labels.shape)}"
        raise InvalidInput(
            f"{path.name} says {list(shape)} pixels (h, w); depth has {list(depth.metres.shape)}{given}.",
            "Mend the frame's files.",
        )
    return FrameImages(depth, camera, labels)


def list_labelled(path: Path) -> dict[int, str]:
    """The frame's objects: label in the label image, and name, empty where it has none.

    They are the `objects`; without any the `object_labels`; without those all that the label image holds but 0.

    Raises:
        PretouchError: as `load_images`.
    """
    description = _description(path)
    try:
        if description.get("objects"):
            return {int(entry["label"]): str(entry["name"]) for entry in description["objects"]}
        listed = description.get("object_labels")
        if listed is not None:
            return {int(label): "" for label in listed}
    except (KeyError, TypeError, ValueError) as error:
        raise _explain_misuse(path, error) from error
    labels = load_images(path).labels
    return {} if labels is None else {int(label): "" for label in np.unique(labels[labels > 0])}


def load_frame(path: Path) -> Frame:
    """Reads a frame with ground-truth poses.

    Raises:
        NotFound: the file, or one that it names, does not exist.
        Malformed: it cannot be read.
        InvalidInput: it has no ground-truth poses, images that do not fit each other, or no table.
    """
    description = _description(path)
    if not description.get("objects"):
        raise InvalidInput(
            f"{path.name} names no object with its pose.",
            "Choose a frame with objects, their meshes and ground-truth poses.",
        )
    images = load_images(path)
    if images.labels is None:
        raise InvalidInput(f"{path.name} names no label image.", "Choose a frame with one.")
    try:
        objects = tuple(_object(path, entry) for entry in description["objects"])
    except (KeyError, TypeError, ValueError) as error:
        raise _explain_misuse(path, error) from error
    table = _table(path.name, images.camera, images.depth, images.labels)
    return Frame(path.stem, images.depth, images.camera, images.labels, objects, table)


def frame_case(frame: Frame, name: str, seed: int) -> Case:
    """The object `name` of the frame with a hidden calibration error, fixed by `seed`, frame and object.

    The base frame has z along the table's normal, x along the camera's view, and the object half a metre ahead. All
    objects of the frame stand in the world that the finger meets.

    Raises:
        NotFound: no such object, or its mesh is missing.
        InvalidInput: the object has no depth.
    """
    mask = frame.mask(name)
    if not mask.any():
        raise InvalidInput(f"{name} has no depth in the frame {frame.name}.", "Choose another object or frame.")
    points = frame.camera.back_project_image(frame.depth.metres)[mask]
    base_T_camera = upright(frame.table, points.mean(axis=0))
    bodies = [
        Body(load_mesh(thing.mesh), base_T_camera @ thing.camera_T_object)
        for thing in sorted(frame.objects, key=lambda thing: thing.name != name)
    ]
    world = World(bodies, frame.table.moved(base_T_camera))
    truth = draw_hidden_offset(base_T_camera.apply(points), generator("frame", seed, frame.name, name))
    extrinsics = truth.inverse() @ base_T_camera
    return Case(f"{frame.name} {name}", seed, frame.depth, frame.camera, extrinsics, mask, world, truth, mask)


def upright(table: Plane, centroid: NDArray[np.float64]) -> Pose:
    """`base_T_camera` for a table and a point in the camera frame, m.

    z along the table's normal, x along the view, the table at z = 0, `centroid` (3,) above `PLACE`.
    """
    z = table.normal
    x = np.array([0.0, 0.0, 1.0]) - z[2] * z
    x = x / np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z])
    shift = PLACE - rotation @ (centroid - table.height(centroid) * z)
    return Pose.of(rotation, shift)


def _table(name: str, camera: Camera, depth: DepthImage, labels: NDArray[np.int64]) -> Plane:
    free = (depth.metres > 0) & ~ndimage.binary_dilation(labels > 0, iterations=_MARGIN)
    table = fit_table(camera.back_project_image(depth.metres)[free], 0.0)
    if table is None:
        raise InvalidInput(f"No table was found in {name}.", "Choose a frame of objects on a table.")
    return table


def _description(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise NotFound(f"There is no frame {path}.", "Give the path of a frame's .json file.")
    try:
        description = json.loads(path.read_text())
    except ValueError as error:
        raise Malformed(f"{path.name} is not JSON.", "Give the path of a frame's .json file.") from error
    missing = [key for key in _KEYS if not isinstance(description, dict) or key not in description]
    if missing:
        raise InvalidInput(
            f"{path.name} has no {', '.join(missing)}.", "Choose a frame with intrinsics, depth unit and images."
        )
    return dict(description)


def _explain_misuse(path: Path, error: Exception) -> Malformed:
    return Malformed(f"{path.name} lacks or misuses {error}.", "See the frames' SOURCES.md for the format.")


def _object(path: Path, entry: dict[str, Any]) -> FrameObject:
    matrix = np.array(entry["T_cam_obj"], dtype=np.float64)
    u, _, vt = np.linalg.svd(matrix[:3, :3])
    matrix[:3, :3] = u @ vt
    try:
        pose = Pose(matrix)
    except PretouchError as error:
        raise Malformed(f"T_cam_obj of {entry['name']}: {error.detail}", error.remedy) from error
    return FrameObject(str(entry["name"]), int(entry["label"]), _file(path, entry["mesh"]), pose)


def _file(frame: Path, name: str) -> Path:
    path = frame.parent / name
    if not path.is_file():
        raise NotFound(f"{frame.name} names {name}, which is not there.", f"Put it at {path}.")
    return path
