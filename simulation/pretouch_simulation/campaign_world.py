"""The world of a campaign: one camera whose calibration is wrong, and objects in turn.

Believed pose B of the camera in base, true pose X G B E: G the error on the base's side and E the one on the camera's
side, the same for all objects until a knock or by a drift, and X what differs from session to session.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from pretouch.errors import InvalidInput
from pretouch.geometry import Array, Pose, rotation_from_vector
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.depth_cameras import realise as realise_camera
from pretouch_simulation.finger import Finger, FingerModel
from pretouch_simulation.finger import realise as realise_finger
from pretouch_simulation.mesh import load_mesh
from pretouch_simulation.protocol import (
    CAMERA_DISTANCE,
    CAMERA_PITCH,
    PLACE,
    TABLE,
    Case,
    draw_offset_about,
    generator,
    look_at,
    view_of,
)
from pretouch_simulation.stable_pose import stand
from pretouch_simulation.world import Body, World

SPREAD = 0.1
"""m: objects stand within so much of `PLACE` along x and y."""
HEADING = float(np.radians(45.0))
"""A moving camera looks along base x, to so much to the left or right."""
_HEIGHT = 0.05  # m, of the point that the camera is aimed at, where no object is known
_BASE_SHARE = 0.5  # of the size of the whole error at the object
_ANOTHER = 10_000  # views of one campaign, so that no two campaigns share a view


@dataclass(frozen=True)
class Change:
    """How far something moves, at the object.

    Attributes:
        translation: m.
        rotation: rad.

    Raises:
        InvalidInput: a value out of its limits.
    """

    translation: float = 0.0
    rotation: float = 0.0

    def __post_init__(self) -> None:
        if not (0 <= self.translation <= 1 and 0 <= self.rotation <= np.pi):
            raise InvalidInput(
                f"A change by {self.translation:g} m and {np.degrees(self.rotation):g} deg is out of its limits.",
                "Give 0 to 1 m and 0 to 180 deg.",
            )

    def draw_exact(self, about: Array, rng: np.random.Generator) -> Pose:
        """A change of just this size, in random directions, about a point (3,), m."""
        turn, shift = _draw_direction(rng) * self.rotation, _draw_direction(rng) * self.translation
        return _turn_about(about, turn, shift)

    def draw_normal(self, about: Array, rng: np.random.Generator) -> Pose:
        """A normal change whose standard deviation along and about each axis is this, about a point (3,), m."""
        turn, shift = rng.standard_normal(3) * self.rotation, rng.standard_normal(3) * self.translation
        return _turn_about(about, turn, shift)


@dataclass(frozen=True)
class CampaignSettings:
    """What the campaigns of an evaluation have in common.

    Attributes:
        objects: how many in turn.
        moving: whether the camera is elsewhere for each object, as on a wrist; else it stays where it is.
        residual: standard deviation, along and about each axis, of what differs from session to session.
        knock_at: the position before which the camera is knocked; None: it is not.
        knock: how far.
        drift: standard deviation, along and about each axis, of the camera's steps from one object to the next.
    """

    objects: int
    moving: bool = False
    residual: Change = Change(0.002, float(np.radians(0.4)))
    knock_at: int | None = None
    knock: Change = Change()
    drift: Change = Change()


@dataclass(frozen=True)
class Campaign:
    """One camera and its objects in turn; all that is random is fixed by `seed` and `number`.

    Attributes:
        meshes: the files, taken in an order of its own, again from the start if there are too few.
    """

    settings: CampaignSettings
    meshes: tuple[Path, ...]
    number: int
    seed: int

    @cached_property
    def paths(self) -> list[Path]:
        """The object of each position."""
        order = generator("campaign-objects", self.seed, self.number).permutation(len(self.meshes))
        return [self.meshes[order[k % len(order)]] for k in range(self.settings.objects)]

    @cached_property
    def _home(self) -> Pose:
        """Where the camera stands at first, apart from the residual."""
        return _draw_camera(_AIM, generator("campaign-camera", self.seed, self.number))

    @cached_property
    def sides(self) -> tuple[Pose, Pose]:
        """E and G at first.

        G B E B^-1 is an error D as in a single session of the protocol, where the camera looks at PLACE from its first
        pose; G is drawn in the same way but half as large, and E is what is left.
        """
        rng = generator("campaign-error", self.seed, self.number)
        whole, base_side = draw_offset_about(_AIM, rng), draw_offset_about(_AIM, rng, _BASE_SHARE)
        believed = whole.inverse() @ self._home
        return believed.inverse() @ base_side.inverse() @ self._home, base_side

    def is_knocked(self, position: int) -> bool:
        """Whether the camera was knocked before the session at `position` or an earlier one."""
        return self.settings.knock_at is not None and position >= self.settings.knock_at

    def camera_side(self, position: int) -> Pose:
        """E at `position`, 1, 2, ...: after knock and drift."""
        camera_side, about = self.sides[0], np.array([0.0, 0.0, float(np.mean(CAMERA_DISTANCE))])
        for k in range(2, position + 1):
            camera_side @= self.settings.drift.draw_normal(
                about, generator("campaign-drift", self.seed, self.number, k)
            )
        if self.is_knocked(position):
            camera_side @= self.settings.knock.draw_exact(about, generator("campaign-knock", self.seed, self.number))
        return camera_side

    def finger(self, model: FingerModel) -> Finger:
        """The robot's fingertip, the same for all objects."""
        return realise_finger(model, generator("campaign-finger", self.seed, self.number))

    def case(self, position: int, model: CameraModel) -> Case:
        """The object at `position`, seen by the campaign's camera.

        Raises:
            PretouchError: the mesh cannot be read or seen.
        """
        rng = generator("campaign-view", self.seed, self.number, position)
        path = self.paths[position - 1]
        resting = stand(load_mesh(path))
        place = PLACE + np.append(rng.uniform(-SPREAD, SPREAD, 2), 0.0)
        body = Body(resting, Pose.from_rotation_vector([0.0, 0.0, rng.uniform(-np.pi, np.pi)], place))
        middle = place + np.array([0.0, 0.0, resting.extents[2] / 2])
        meant = _draw_camera(middle, rng, HEADING) if self.settings.moving else self._home
        residual = self.settings.residual.draw_normal(middle, rng)
        first_camera_side, base_side = self.sides
        believed = base_side.inverse() @ meant @ first_camera_side.inverse()
        true_camera = residual @ base_side @ believed @ self.camera_side(position)
        camera = realise_camera(model, generator("campaign-camera-model", self.seed, self.number))
        truth = true_camera @ believed.inverse()
        view = self.number * _ANOTHER + position
        return view_of(path.stem, view, World([body], TABLE), true_camera, camera, rng, lambda _: truth)


def campaigns(settings: CampaignSettings, meshes: Sequence[Path], count: int, seed: int) -> list[Campaign]:
    """The first `count` campaigns of the seed."""
    return [Campaign(settings, tuple(meshes), number, seed) for number in range(count)]


_AIM = PLACE + np.array([0.0, 0.0, _HEIGHT])


def _draw_camera(target: Array, rng: np.random.Generator, heading: float = 0.0) -> Pose:
    """`base_T_camera` that looks at `target` (3,), m, as in the protocol but from up to `heading` rad to the side."""
    ahead = look_at(target, rng.uniform(*CAMERA_DISTANCE), rng.uniform(*CAMERA_PITCH))
    return _turn_about(target, np.array([0.0, 0.0, rng.uniform(-heading, heading)]), np.zeros(3)) @ ahead


def _turn_about(point: Array, turn: Array, shift: Array) -> Pose:
    """Turns by the rotation vector (3,) about `point`, then shifts."""
    rotation = rotation_from_vector(turn)
    return Pose.of(rotation, point + shift - rotation @ point)


def _draw_direction(rng: np.random.Generator) -> Array:
    direction = rng.standard_normal(3)
    return np.asarray(direction / np.linalg.norm(direction), dtype=np.float64)
