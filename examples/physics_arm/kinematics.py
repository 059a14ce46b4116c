"""Inverse kinematics by damped least squares, within the joints' limits and clear of table and arm."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from examples.physics_arm.world import World, get_tip_pose
from pretouch.client import Reflex
from pretouch.geometry import vector_from_rotation

Array = NDArray[np.float64]

_STARTS = [np.array([turn, 0.3, 0.0, -2.0, 0.0, 2.3, 0.785]) for turn in (0.0, 0.4, -0.4)]
"""rad: where the search for a path's first pose begins."""
_STEPS = 100
_DAMPING = 0.02
_COMFORT = 0.02
"""Share of the way to the middle of the joints' ranges that each step goes where the tip does not mind."""
_REACHED = (2e-4, 1e-3)  # m, rad
_TURNS = np.radians([0, 30, -30, 60, -60, 90, -90, 135, -135, 180])
"""About the beam: pretouch leaves this turn to the robot, as long as it stays the same over a scan."""
_FASTEST = 1.5
"""rad/s of any joint."""


def follow(world: World, times: Array, base_T_tip: Array, start: Array | None = None) -> Array | None:
    """The joint angles (n, 7), rad, that lead the tip along poses (n, 4, 4) at times (n,), s, turned about the beam.

    `start`: angles (7,) near which the first ones are searched; None: anywhere.
    None where no turn about the beam is within reach, limits and joint speeds, and clear of table and arm.
    """
    for turn in _TURNS:
        spin = np.eye(4)
        spin[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        path = _solve_path(world, base_T_tip @ spin, _STARTS if start is None else [start])
        if path is not None and (np.abs(np.diff(path, axis=0)) <= _FASTEST * np.diff(times)[:, None]).all():
            return path
    return None


def raise_tip(world: World, joints: Array, reflex: Reflex) -> Array | None:
    """The joint angles (7,), rad, that hold the tip above where `joints` would, as `reflex` lifts it.

    None where they are out of reach or limits.
    """
    state = mujoco.MjData(world.model)
    state.qpos[:] = joints
    mujoco.mj_fwdPosition(world.model, state)
    return _solve(world, state, reflex.raise_tip(get_tip_pose(state)), [joints])


def collides(world: World, joints: Array) -> bool:
    """Whether the arm would touch the table or itself at these angles; where the object is the robot does not know."""
    state = mujoco.MjData(world.model)
    state.qpos[:] = joints
    mujoco.mj_fwdPosition(world.model, state)
    return _touches_known_things(world, state)


def _touches_known_things(world: World, state: mujoco.MjData) -> bool:
    return not np.isin(state.contact.geom, world.object_geoms()).any(axis=1).all()


def _solve_path(world: World, poses: Array, starts: Sequence[Array]) -> Array | None:
    path: list[Array] = []
    state = mujoco.MjData(world.model)
    for pose in poses:
        joints = _solve(world, state, pose, path[-1:] or starts)
        if joints is None or _touches_known_things(world, state):
            return None
        path.append(joints)
    return np.stack(path)


def _solve(world: World, state: mujoco.MjData, pose: Array, starts: Sequence[Array]) -> Array | None:
    """The angles (7,) at which the tip is at `pose`, searched from each of `starts`; leaves `state` there."""
    model = world.model
    low, high = model.jnt_range.T
    jacobian, tip = np.zeros((6, model.nv)), model.site("tip").id
    for start in starts:
        state.qpos[:] = start
        for _ in range(_STEPS):
            mujoco.mj_fwdPosition(model, state)
            rotation = state.site_xmat[tip].reshape(3, 3)
            shift, turn = pose[:3, 3] - state.site_xpos[tip], vector_from_rotation(pose[:3, :3] @ rotation.T)
            if np.linalg.norm(shift) < _REACHED[0] and np.linalg.norm(turn) < _REACHED[1]:
                return np.array(state.qpos)
            mujoco.mj_jacSite(model, state, jacobian[:3], jacobian[3:], tip)
            inverse = jacobian.T @ np.linalg.inv(jacobian @ jacobian.T + _DAMPING**2 * np.eye(6))
            comfort = _COMFORT * ((low + high) / 2 - state.qpos)
            step = inverse @ np.concatenate([shift, turn]) + comfort - inverse @ (jacobian @ comfort)
            state.qpos[:] = np.clip(state.qpos + np.clip(step, -0.3, 0.3), low, high)
    return None
