"""How the errors of a camera's two sides show in a session's correction."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pretouch.geometry import Array, Pose, rotation_from_vector, vector_from_rotation


class Sides(NamedTuple):
    """The errors of both sides, and the points about which their rotations are counted.

    A small change (rotation vector w, translation t) of a side moves what it maps to, near its own image of `pivot`:
    x to pivot' + exp(w) (x - pivot') + t with pivot' = side(pivot). Changes of both are one vector (12,), the camera's
    side first.

    Attributes:
        camera_T_camera: E.
        base_T_base: G.
        camera_pivot: (3,), m, in the camera's frame.
        base_pivot: (3,), m, in base.
    """

    camera_T_camera: Pose
    base_T_base: Pose
    camera_pivot: Array
    base_pivot: Array

    def correct(self, base_T_camera: Pose) -> Pose:
        """The camera's true pose G B E where it is believed at B."""
        return self.base_T_base @ base_T_camera @ self.camera_T_camera

    def correction(self, base_T_camera: Pose) -> Pose:
        """G B E B^-1: maps a point from where the camera puts it to where it is, both in base."""
        return self.correct(base_T_camera) @ base_T_camera.inverse()

    def jacobian(self, base_T_camera: Pose, point: Array) -> Array:
        """(6, 12): the change of `correction` at the point (3,), m, in base as believed, by changes of both sides."""
        in_camera = self.camera_T_camera.apply(base_T_camera.rotation.T @ (point - base_T_camera.translation))
        turn = self.base_T_base.rotation @ base_T_camera.rotation
        camera_arm = turn @ (in_camera - self.camera_T_camera.apply(self.camera_pivot))
        base_arm = self.base_T_base.rotation @ (base_T_camera.apply(in_camera) - self.base_pivot)
        jacobian = np.zeros((6, 12))
        jacobian[:3, 0:3], jacobian[:3, 6:9] = turn, np.eye(3)
        jacobian[3:, 0:3], jacobian[3:, 3:6] = -cross_matrix(camera_arm) @ turn, turn
        jacobian[3:, 6:9], jacobian[3:, 9:12] = -cross_matrix(base_arm), np.eye(3)
        return jacobian

    def changed(self, change: Array) -> Sides:
        """The sides after a change (12,)."""
        return self._replace(
            camera_T_camera=_change(self.camera_T_camera, self.camera_pivot, change[:6]),
            base_T_base=_change(self.base_T_base, self.base_pivot, change[6:]),
        )

    def change_to_nothing(self) -> Array:
        """(12,): the change after which both sides are without error."""
        return np.concatenate(
            [_undo(self.camera_T_camera, self.camera_pivot), _undo(self.base_T_base, self.base_pivot)]
        )

    def about_origins(self) -> Array:
        """(12, 12): turns changes about the pivots into the same changes about the frames' origins."""
        moves = np.eye(12)
        moves[3:6, 0:3] = cross_matrix(self.camera_T_camera.rotation @ self.camera_pivot)
        moves[9:12, 6:9] = cross_matrix(self.base_T_base.rotation @ self.base_pivot)
        return moves


def cross_matrix(v: Array) -> Array:
    """(3, 3): [v]x, so that [v]x u = v x u."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _change(side: Pose, pivot: Array, change: Array) -> Pose:
    image = side.apply(pivot)
    turn = rotation_from_vector(change[:3])
    return Pose.of(turn, image - turn @ image + change[3:]) @ side


def _undo(side: Pose, pivot: Array) -> Array:
    return np.concatenate([-vector_from_rotation(side.rotation), pivot - side.apply(pivot)])
