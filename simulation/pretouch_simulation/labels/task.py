"""A view to label: the object, its resting pose, and the camera's place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from pretouch.errors import InvalidInput
from pretouch.scene import Scene
from pretouch_simulation.depth_cameras import CameraModel, realise
from pretouch_simulation.labels.procedural import make_procedural, procedural_name
from pretouch_simulation.labels.view import LabelView, view_of
from pretouch_simulation.mesh import load_mesh
from pretouch_simulation.protocol import Case, case_of, generator
from pretouch_simulation.split import object_of, split_of
from pretouch_simulation.stable_pose import find_resting_poses

_POSES = 3
"""Resting poses that are computed; an object with fewer repeats them, seen from other places."""


class ViewTask(Protocol):
    """What can be labelled: a `Task`, or an object of a depth frame."""

    @property
    def name(self) -> str:
        """Of the view, unique in its dataset."""

    @property
    def object(self) -> str:
        """All views of it are on one side."""

    @property
    def side(self) -> str:
        """train or validation."""

    @property
    def provenance(self) -> dict[str, Any]:
        """Where the view comes from."""

    def scene(self, seed: int) -> tuple[Scene, tuple[int, int]]:
        """What a session sees, and its first pixel (u0, v0); raises `PretouchError` if there is no object."""

    def load_view(self, seed: int) -> LabelView:
        """The view with its world; raises `PretouchError` if there is no world."""


@dataclass(frozen=True)
class Task:
    """A view of a mesh file, or of the procedural object of a number.

    Attributes:
        source: the mesh file, or the number.
        pose: which of the object's resting poses, modulo their number.
        view: which camera place and calibration error.
        camera: which depth camera looks.
    """

    source: Path | int
    pose: int
    view: int
    camera: CameraModel = CameraModel.KINECT

    @property
    def stem(self) -> str:
        """What the object is called."""
        return self.source.stem if isinstance(self.source, Path) else f"code__{procedural_name(self.source)}"

    @property
    def name(self) -> str:
        """Of the view."""
        return f"{self.stem}-{self.pose}-{self.view}"

    @property
    def object(self) -> str:
        """It decides the side; objects made in code are always on `train`."""
        return object_of(self.stem) if isinstance(self.source, Path) else self.stem

    @property
    def side(self) -> str:
        """train or validation."""
        return split_of(self.stem).value if isinstance(self.source, Path) else "train"

    @property
    def provenance(self) -> dict[str, Any]:
        source = self.source.name if isinstance(self.source, Path) else "made in code"
        return {"source": source, "pose": self.pose, "view": self.view, "camera": self.camera.value}

    def scene(self, seed: int) -> tuple[Scene, tuple[int, int]]:
        """What a session sees, and its first pixel; raises as `case`."""
        view = self.load_view(seed)
        return view.scene, view.origin

    def load_view(self, seed: int) -> LabelView:
        """The view as a session sees it, and its world; raises as `case`."""
        return view_of(self.case(seed))

    def case(self, seed: int) -> Case:
        """The view itself.

        Raises:
            PretouchError: the mesh cannot be read, has no volume, or is not seen.
        """
        mesh = load_mesh(self.source) if isinstance(self.source, Path) else make_procedural(self.source)[1]
        poses = find_resting_poses(mesh, _POSES)
        return case_of(
            self.name,
            poses[self.pose % len(poses)],
            self.view,
            generator("label view", seed, self.stem, self.pose, self.view),
            realise(self.camera, generator("label camera", seed, self.stem, self.pose, self.view)),
        )


def tasks_of(
    meshes: Sequence[Path],
    made_in_code: int,
    poses: int,
    views: int,
    camera: CameraModel = CameraModel.KINECT,
) -> list[Task]:
    """All views, ordered so that every object comes once before any comes again: each prefix is a fair sample.

    Raises:
        InvalidInput: there is no object.
    """
    sources: list[Path | int] = [*meshes, *range(made_in_code)]
    if not sources:
        raise InvalidInput("There is no object to label.", "Give --meshes, --frames or --made-in-code.")
    return [Task(source, pose, view, camera) for view in range(views) for pose in range(poses) for source in sources]
