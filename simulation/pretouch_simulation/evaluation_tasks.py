"""What an evaluation runs sessions on: views of meshes, and objects of real frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pretouch.errors import InvalidInput, NotFound, PretouchError
from pretouch_simulation.clutter import place_neighbours
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.frames import frame_case, load_frame
from pretouch_simulation.mesh import Mesh, load_mesh
from pretouch_simulation.protocol import Case, generator, make_case
from pretouch_simulation.stable_pose import find_resting_poses

_RESTING_POSES = 3
"""Poses in which a neighbour may stand or lie."""
MIN_PIXELS = 1000
"""An object of a frame must have more pixels with depth than this."""


class MeshTask(NamedTuple):
    """A view of a mesh file, seen by a simulated camera.

    Attributes:
        others: mesh files, some of which stand around it; none: it stands alone.
    """

    path: Path
    view: int
    others: tuple[Path, ...] = ()

    @property
    def mesh(self) -> str:
        return self.path.stem

    @property
    def frame(self) -> None:
        return None

    @property
    def scene(self) -> str:
        """What the rows call it."""
        return "clutter" if self.others else "alone"

    def camera(self, model: CameraModel) -> str:
        """What the rows call the camera."""
        return model.value

    def case(self, seed: int, camera: CameraModel) -> Case:
        """Fixed by the file's stem, the view, the camera, `seed` and the names of the others.

        Object, view and camera are those of the object alone.

        Raises:
            PretouchError: the mesh cannot be read or seen, or too few of the others fit around it.
        """
        surround = None
        if self.others:
            rng = generator("clutter", seed, self.mesh, self.view)
            surround = partial(place_neighbours, _draw_resting_poses(self.others, rng), rng)
        return make_case(self.mesh, load_mesh(self.path), self.view, seed, camera, surround)


def _draw_resting_poses(paths: Sequence[Path], rng: np.random.Generator) -> Iterator[list[Mesh]]:
    """The resting poses of the meshes in random order, without those that cannot be read or have no volume."""
    for k in rng.permutation(len(paths)):
        with suppress(PretouchError):
            yield find_resting_poses(load_mesh(paths[k]), _RESTING_POSES)


class FrameTask(NamedTuple):
    """An object of a real frame's .json file; `view` is the seed of the hidden calibration error."""

    path: Path
    mesh: str
    view: int

    @property
    def frame(self) -> str:
        return self.path.stem

    @property
    def scene(self) -> None:
        return None

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


def mesh_tasks(paths: Sequence[Path], views: Iterable[int], around: Sequence[Path] = ()) -> list[MeshTask]:
    """The views of each mesh, among the other meshes of `around` if any are given.

    Raises:
        InvalidInput: `around` holds one mesh only.
    """
    if len(around) == 1:
        raise InvalidInput(f"There is no other mesh to stand around {around[0].stem}.", "Leave out --clutter.")
    views = tuple(views)
    return [MeshTask(path, view, tuple(other for other in around if other != path)) for path in paths for view in views]


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
