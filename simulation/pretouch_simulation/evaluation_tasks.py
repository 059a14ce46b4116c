"""What an evaluation runs sessions on: views of meshes, and objects of real frames."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from pretouch.errors import NotFound
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.frames import frame_case, load_frame
from pretouch_simulation.mesh import load_mesh
from pretouch_simulation.protocol import Case, make_case

MIN_PIXELS = 1000
"""An object of a frame must have more pixels with depth than this."""


class MeshTask(NamedTuple):
    """A view of a mesh file, seen by a simulated camera."""

    path: Path
    view: int

    @property
    def mesh(self) -> str:
        return self.path.stem

    @property
    def frame(self) -> None:
        return None

    def camera(self, model: CameraModel) -> str:
        """What the rows call the camera."""
        return model.value

    def case(self, seed: int, camera: CameraModel) -> Case:
        """Fixed by the file's stem, the view, the camera and `seed`.

        Raises:
            PretouchError: the mesh cannot be read or seen.
        """
        return make_case(self.mesh, load_mesh(self.path), self.view, seed, camera=camera)


class FrameTask(NamedTuple):
    """An object of a real frame's .json file; `view` is the seed of the hidden calibration error."""

    path: Path
    mesh: str
    view: int

    @property
    def frame(self) -> str:
        return self.path.stem

    def camera(self, model: CameraModel) -> str:
        """Not simulated, whatever the model."""
        return "real"

    def case(self, seed: int, camera: CameraModel) -> Case:
        """Fixed by the frame, the object and the view alone.

        Raises:
            PretouchError: the frame cannot be read.
        """
        return frame_case(load_frame(self.path), self.mesh, self.view)


Task = MeshTask | FrameTask
"""All protocols run on it in one process, so that its images are made only once for each camera."""


def frame_tasks(paths: Sequence[Path], seeds: Iterable[int]) -> list[FrameTask]:
    """Every object with more than `MIN_PIXELS` pixels of depth in each frame, once for each seed.

    Raises:
        NotFound: there is none.
        PretouchError: a frame cannot be read.
    """
    seeds = tuple(seeds)
    tasks = []
    for path in paths:
        frame = load_frame(path)
        large = [thing.name for thing in frame.objects if frame.mask(thing.name).sum() > MIN_PIXELS]
        tasks += [FrameTask(path, name, seed) for name in large for seed in seeds]
    if not tasks:
        raise NotFound(
            f"No object in {', '.join(path.name for path in paths)} has more than {MIN_PIXELS} pixels of depth.",
            "Choose frames that show their objects larger.",
        )
    return tasks
