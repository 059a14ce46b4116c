"""A view to label of an object in a depth frame, with or without ground truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pretouch.errors import InvalidInput, NotFound, PretouchError
from pretouch.geometry import Pose
from pretouch.scene import Scene
from pretouch_simulation.frames import frame_case, list_labelled, load_frame, load_images, upright
from pretouch_simulation.labels.view import LabelView, scene_of, view_of
from pretouch_simulation.split import object_of, split_of


@dataclass(frozen=True)
class FrameTask:
    """A labelled object of a frame.

    Attributes:
        file: the frame's .json.
        label: the object's in the label image; None: there is no label image, and the object is segmented.
        called: the object's name; empty if the frame has none.
    """

    file: Path
    label: int | None = None
    called: str = ""

    @property
    def name(self) -> str:
        """Of the view."""
        return self.file.stem if self.label is None else f"{self.file.stem}-{self.label}"

    @property
    def object(self) -> str:
        """It decides the side; nameless objects of one frame are on the same side."""
        return object_of(self.called or self.file.stem)

    @property
    def side(self) -> str:
        """train or validation."""
        return split_of(self.called or self.file.stem).value

    @property
    def provenance(self) -> dict[str, Any]:
        return {"source": self.file.name, "label": self.label, "called": self.called}

    def scene(self, seed: int) -> tuple[Scene, tuple[int, int]]:
        """What a session sees of it, base upright on the table, and the view's first pixel; whatever the seed.

        Raises:
            PretouchError: the frame cannot be read, or shows no object or no table.
        """
        images = load_images(self.file)
        mask = None
        if images.labels is not None:
            if self.label is None:
                raise InvalidInput(f"{self.file.name} labels no object.", "Label one, or leave the frame out.")
            mask = images.labels == self.label
            if not mask.any():
                raise InvalidInput(
                    f"The label image of {self.file.name} holds no pixel of object {self.label}.",
                    "Mend the label image, or leave the object out.",
                )
        scene, origin = scene_of(images.camera, Pose.identity(), images.depth, mask)
        base_T_camera = upright(scene.table, scene.centroid)
        return replace(scene, base_T_camera=base_T_camera, table=scene.table.moved(base_T_camera)), origin

    def load_view(self, seed: int) -> LabelView:
        """The view with the world that the finger meets.

        Raises:
            PretouchError: the frame has no poses and meshes, or as for `scene`.
        """
        return view_of(frame_case(load_frame(self.file), self.called, seed))


def frame_tasks(folder: Path) -> list[FrameTask]:
    """All objects of all frames, by the frames' names. A frame without any, or a broken one, becomes a task that fails.

    Raises:
        NotFound: no such folder, or no frame in it.
    """
    if not folder.is_dir():
        raise NotFound(f"There is no folder {folder}.", "Give a folder of depth frames.")
    files = sorted(folder.glob("*.json"))
    if not files:
        raise NotFound(f"{folder} holds no frame.", "Give a folder with a .json file for each depth image.")
    return [task for file in files for task in _objects_of(file)]


def _objects_of(file: Path) -> list[FrameTask]:
    try:
        found = list_labelled(file)
    except PretouchError:
        found = {}
    return [FrameTask(file, label, called) for label, called in found.items()] or [FrameTask(file)]
