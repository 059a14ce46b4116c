"""The evaluation protocol: an object on a table, a camera whose extrinsics are wrong, and how an estimate is scored."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pretouch.camera import Camera, DepthImage
from pretouch.errors import InvalidInput
from pretouch.estimate import Estimate
from pretouch.geometry import Array, Plane, Pose, rotation_from_vector, vector_from_rotation
from pretouch_simulation.depth_cameras import CameraModel, DepthCamera, realise
from pretouch_simulation.depth_cameras.kinect import Kinect
from pretouch_simulation.mesh import Mesh
from pretouch_simulation.stable_pose import stand
from pretouch_simulation.world import Body, World

CAMERA = Camera(525.0, 525.0, 319.5, 239.5)
TABLE = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
PLACE = np.array([0.5, 0.0, 0.0])
"""m, in base: where the object stands."""
CAMERA_DISTANCE = (0.8, 1.0)
CAMERA_PITCH = tuple(np.radians([40.0, 50.0]))
OFFSET_TRANSLATION = 0.02
OFFSET_ROTATION = float(np.radians(5.0))
CHI2_6_95 = 12.59
KINECT = Kinect()
Surround = Callable[[Body, Pose], Sequence[Body]]
"""What stands around the object, given it and the true `base_T_camera`."""


def generator(*names: object) -> np.random.Generator:
    """A random generator seeded by the names, the same on every machine and in every process."""
    digest = hashlib.blake2b("\x1f".join(str(name) for name in names).encode(), digest_size=16).digest()
    return np.random.default_rng(int.from_bytes(digest, "little"))


@dataclass(frozen=True, eq=False)
class Case:
    """One view of one object, together with the truth.

    Attributes:
        name, view: which mesh, which of its views.
        depth, camera, base_T_camera: the client's; the extrinsics are wrong.
        mask: (h, w) bool, the client's: where it takes the object to be and there is a depth.
        world: what the finger meets, at its true place in base.
        truth: the right `base_T_correction`.
        scored: (h, w) bool, the true object pixels with a depth.
    """

    name: str
    view: int
    depth: DepthImage
    camera: Camera
    base_T_camera: Pose
    mask: NDArray[np.bool_]
    world: World
    truth: Pose
    scored: NDArray[np.bool_]

    @cached_property
    def cloud(self) -> Array:
        """(n, 3), m: the object's points as the camera puts them in base."""
        return self.base_T_camera.apply(self.camera.back_project_image(self.depth.metres)[self.scored])

    def error(self, base_T_correction: Pose) -> float:
        """m: mean distance of the object's points, as corrected, from their true place."""
        cloud = self.cloud
        return float(np.linalg.norm(self.truth.apply(cloud) - base_T_correction.apply(cloud), axis=1).mean())

    def deviation(self, estimate: Estimate) -> Array:
        """(6,): the pose error in the order of `estimate.covariance`, (rotation vector, translation), rad and m."""
        turn = vector_from_rotation(self.truth.rotation @ estimate.base_T_correction.rotation.T)
        shift = self.truth.apply(estimate.centroid) - estimate.base_T_correction.apply(estimate.centroid)
        return np.concatenate([turn, shift])

    def is_covered_by(self, estimate: Estimate) -> bool:
        """Whether the truth lies in the estimate's 95 % region."""
        error = self.deviation(estimate)
        return bool(error @ np.linalg.solve(estimate.covariance, error) <= CHI2_6_95)


def draw_hidden_offset(true_cloud: Array, rng: np.random.Generator) -> Pose:
    """The calibration error D, which is the true `base_T_correction`.

    Args:
        true_cloud: (n, 3), m, the object's points at their true place in base.
    """
    turn, shift = _draw(rng)
    centroid = true_cloud.mean(axis=0) - shift
    return Pose.of(turn, centroid + shift - turn @ centroid)


def draw_offset_about(centroid: Array, rng: np.random.Generator, size: float = 1.0) -> Pose:
    """As `draw_hidden_offset`, `size` times as large, where the cloud's centroid (3,), m, is as the camera puts it."""
    turn, shift = _draw(rng, size)
    return Pose.of(turn, centroid + shift - turn @ centroid)


def _draw(rng: np.random.Generator, size: float = 1.0) -> tuple[Array, Array]:
    """Roll, pitch, yaw uniform in +-5 deg (extrinsic xyz, base axes), (3, 3), and a shift (3,) of uniform +-2 cm.

    Both are `size` times as large.
    """
    roll, pitch, yaw = size * rng.uniform(-OFFSET_ROTATION, OFFSET_ROTATION, 3)
    shift = size * rng.uniform(-OFFSET_TRANSLATION, OFFSET_TRANSLATION, 3)
    turn = rotation_from_vector([0, 0, yaw]) @ rotation_from_vector([0, pitch, 0]) @ rotation_from_vector([roll, 0, 0])
    return turn, shift


def make_case(
    name: str,
    mesh: Mesh,
    view: int,
    seed: int = 0,
    camera: CameraModel = CameraModel.KINECT,
    surround: Surround | None = None,
) -> Case:
    """View number `view` of `mesh` on the table; what is random but `surround` is fixed by `seed`, `name` and `view`.

    Raises:
        InvalidInput: the camera does not see the object.
    """
    realised = realise(camera, generator("camera", seed, name, view))
    return case_of(name, stand(mesh), view, generator("view", seed, name, view), realised, surround)


def case_of(
    name: str,
    resting: Mesh,
    view: int,
    rng: np.random.Generator,
    camera: DepthCamera = KINECT,
    surround: Surround | None = None,
) -> Case:
    """A view of a mesh that rests on z = 0, centred on x = y = 0, in a random yaw from a random place.

    Args:
        surround: left out, the object stands alone.

    Raises:
        InvalidInput: the camera does not see the object.
    """
    base_T_mesh = Pose.from_rotation_vector([0.0, 0.0, rng.uniform(-np.pi, np.pi)], PLACE)
    target = Body(resting, base_T_mesh)
    middle = PLACE + np.array([0.0, 0.0, resting.extents[2] / 2])
    true_camera = look_at(middle, rng.uniform(*CAMERA_DISTANCE), rng.uniform(*CAMERA_PITCH))
    world = World([target, *(surround(target, true_camera) if surround else ())], TABLE)
    return view_of(name, view, world, true_camera, camera, rng, lambda cloud: draw_hidden_offset(cloud, rng))


def view_of(
    name: str,
    view: int,
    world: World,
    true_camera: Pose,
    camera: DepthCamera,
    rng: np.random.Generator,
    find_truth: Callable[[Array], Pose],
) -> Case:
    """What a camera truly at `true_camera` in base sees of the world's first body.

    Args:
        rng: of the image's noise.
        find_truth: the right `base_T_correction`, given the object's points (n, 3), m, at their true place in base.

    Raises:
        InvalidInput: the camera does not see the object.
    """
    image = camera.render(world, CAMERA, true_camera, rng)
    scored = (image.bodies == 0) & (image.depth.metres > 0)
    if not (scored.any() and image.mask.any()):
        raise InvalidInput(f"The camera does not see {name}.", "Give a larger mesh, in metres.")
    truth = find_truth(true_camera.apply(CAMERA.back_project_image(image.depth.metres)[scored]))
    return Case(name, view, image.depth, CAMERA, truth.inverse() @ true_camera, image.mask, world, truth, scored)


def look_at(target: Array, distance: float, pitch: float) -> Pose:
    """`base_T_camera` at `distance`, m, from `target` (3,), looking along base x and `pitch` rad down."""
    z = np.array([np.cos(pitch), 0.0, -np.sin(pitch)])
    x = np.array([0.0, -1.0, 0.0])
    return Pose.of(np.stack([x, np.cross(z, x), z], axis=1), target - distance * z)
