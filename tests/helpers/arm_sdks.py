"""Fake arms behind the vendors' own signatures, and a fake gateway that listens to tip poses.

A call that the real class would refuse (no such method or argument, a list for a number) fails the test.
"""

from __future__ import annotations

import inspect
import re
import time
from collections.abc import Callable, Iterable, Iterator
from datetime import timedelta
from typing import Any

import numpy as np

from pretouch.client.reflex import RANGE_UNDERFLOW
from pretouch.geometry import Array, Pose, rotation_from_vector, vector_from_rotation
from pretouch.tof import RangeSamples
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import samples_to_proto

START = Pose.of(np.diag([1.0, -1.0, -1.0]), [0.3, 0.1, 0.6]).matrix
"""base_T_flange before the first motion."""


class Checked:
    """`fake`, whose calls must fit the class `real`."""

    def __init__(self, real: type, fake: Any) -> None:
        self._real, self._fake = real, fake

    def __getattr__(self, name: str) -> Callable[..., Any]:
        method = getattr(self._fake, name)

        def call(*args: Any, **kwargs: Any) -> Any:
            check_call(getattr(self._real, name), *args, **kwargs)
            return method(*args, **kwargs)

        return call


def check_call(function: Any, *args: Any, **kwargs: Any) -> None:
    """Raises TypeError unless the method takes these arguments, `self` left out."""
    refusals = []
    for signature in _signatures(function):
        try:
            _check_bound(signature.bind(None, *args, **kwargs), signature)
            return
        except TypeError as error:
            refusals.append(str(error))
    raise TypeError(f"{function.__name__}: {'; '.join(refusals)}")


def _check_bound(bound: inspect.BoundArguments, signature: inspect.Signature) -> None:
    for name, value in bound.arguments.items():
        parameter = signature.parameters[name]
        if parameter.kind is inspect.Parameter.VAR_KEYWORD and value:
            raise TypeError(f"{sorted(value)} are no named arguments")
        if parameter.annotation == "float" and not isinstance(value, int | float):
            raise TypeError(f"{name} is {value!r}, no number")
        if parameter.annotation == "list[float]" and not all(isinstance(number, int | float) for number in value):
            raise TypeError(f"{name} is {value!r}, no list of numbers")


def _signatures(function: Any) -> Iterator[inspect.Signature]:
    """Of a Python function, or each overload that pybind11 writes into the docstring."""
    if inspect.isfunction(function):
        yield inspect.signature(function)
        return
    pattern = rf"^(?:\d+\. )?{function.__name__}\((self: .*)\) -> "
    for line in re.findall(pattern, function.__doc__, re.MULTILINE):
        parameters = []
        for part in re.split(r", (?![^\[<]*[\]>])", line):
            name, _, rest = part.partition(": ")
            annotation, equals, default = rest.partition(" = ")
            parameters.append(
                inspect.Parameter(
                    name,
                    inspect.Parameter.POSITIONAL_OR_KEYWORD,
                    default=default if equals else inspect.Parameter.empty,
                    annotation=annotation,
                )
            )
        yield inspect.Signature(parameters)


class FakeUr:
    """Control and receive interface of one UR; pose vectors are those of the tool centre point, m and rad.

    Attributes:
        flange: base_T_flange, the truth of all fakes.
        reach: m in x up to which poses are within the safety limits.
        motions: what it was told to do, in order.
    """

    def __init__(self) -> None:
        self.flange, self.reach = START, 10.0
        self.motions: list[str] = []
        self._flange_T_tcp = np.eye(4)

    def setTcp(self, pose: list[float]) -> bool:
        self._flange_T_tcp = _matrix(pose, pose[3:])
        return True

    def getActualTCPPose(self) -> list[float]:
        tcp = self.flange @ self._flange_T_tcp
        return [*tcp[:3, 3], *vector_from_rotation(tcp[:3, :3])]

    def isPoseWithinSafetyLimits(self, pose: list[float]) -> bool:
        return pose[0] <= self.reach

    def moveL(self, pose: list[float], speed: float, acceleration: float) -> bool:
        self.motions.append("move")
        self.flange = _matrix(pose, pose[3:]) @ np.linalg.inv(self._flange_T_tcp)
        return True

    def servoL(self, pose: list[float], *_: float) -> bool:
        self.motions.append("servo")
        self.flange = _matrix(pose, pose[3:]) @ np.linalg.inv(self._flange_T_tcp)
        return True

    def servoStop(self) -> bool:
        self.motions.append("stop")
        return True

    def initPeriod(self) -> timedelta:
        return timedelta()

    def waitPeriod(self, start: timedelta) -> None: ...


class FakeXArm:
    """An xArm; poses are those of the flange, mm and rad. It moves in mode 0, follows in mode 1."""

    def __init__(self) -> None:
        self.flange, self.reach = START, 10.0
        self.asked: list[Array] = []
        self.motions: list[str] = []
        self._mode = -1

    def motion_enable(self, enable: bool) -> int:
        return 0

    def set_tcp_offset(self, offset: list[float]) -> int:
        return int(any(offset))

    def set_mode(self, mode: int) -> int:
        self._mode = -1 - mode  # not in force before set_state
        return 0

    def set_state(self, state: int) -> int:
        self._mode = -1 - self._mode
        return state

    def get_position_aa(self, is_radian: bool) -> tuple[int, list[float]]:
        assert is_radian
        return 0, [*(1000 * self.flange[:3, 3]), *vector_from_rotation(self.flange[:3, :3])]

    def get_inverse_kinematics(self, pose: list[float], input_is_radian: bool) -> tuple[int, list[float]]:
        assert input_is_radian
        roll, pitch, yaw = (np.eye(3)[axis] * angle for axis, angle in enumerate(pose[3:]))
        rotation = rotation_from_vector(yaw) @ rotation_from_vector(pitch) @ rotation_from_vector(roll)
        self.asked.append(Pose.of(rotation, np.array(pose[:3]) / 1000).matrix)
        return (0, [0.0] * 7) if pose[0] <= 1000 * self.reach else (-10, [])

    def set_position_aa(self, pose: list[float], speed: float, mvacc: float, is_radian: bool, wait: bool) -> int:
        assert is_radian
        assert wait
        return self._go(pose, 0, "move")

    def set_servo_cartesian_aa(self, pose: list[float], is_radian: bool) -> int:
        assert is_radian
        return self._go(pose, 1, "servo")

    def _go(self, pose: list[float], mode: int, motion: str) -> int:
        if self._mode != mode:
            return 9  # not ready to move
        self.motions.append(motion)
        self.flange = _matrix(np.array(pose[:3]) / 1000, pose[3:])
        return 0


class FakeFranka:
    """A Franka under franky, whose end effector is the flange; its motions are franky's own objects.

    A motion beyond `reach` stops half-way by the control exception `refusal`; a new motion takes over from the one
    before.
    """

    def __init__(self, refusal: type[Exception], pose: Callable[[Array], Any]) -> None:
        self.flange, self.reach = START, 10.0
        self.motions: list[str] = []
        self.relative_dynamics_factor = 1.0
        self.stopped = False
        self._refusal, self._pose = refusal, pose
        self._coming: list[tuple[float, Array]] = []
        self._from = time.monotonic(), START

    @property
    def current_pose(self) -> Any:
        return self._pose(self.flange)

    def recover_from_errors(self) -> bool:
        self.stopped = False
        return True

    def move(self, motion: Any, asynchronous: bool) -> None:
        assert asynchronous
        assert not self.stopped
        tip_T_flange = np.linalg.inv(motion.ee_frame.matrix)
        at = time.monotonic()
        self._from, self._coming = (at, self.flange), []
        for waypoint in motion.waypoints:
            at += waypoint.minimum_time.to_msec() / 1000 if waypoint.minimum_time is not None else 0.0
            self._coming.append((at, waypoint.target.pose.end_effector_pose.matrix @ tip_T_flange))
        self.motions.append("move" if len(motion.waypoints) == 1 else "servo")

    def poll_motion(self) -> bool:
        now = time.monotonic()
        while self._coming and self._coming[0][0] <= now:
            self._from = self._coming.pop(0)
            self._reach_for(self._from[1])
        if self._coming:
            (t0, start), (t1, goal) = self._from, self._coming[0]
            pose = goal.copy()
            pose[:3, 3] = start[:3, 3] + (now - t0) / (t1 - t0) * (goal[:3, 3] - start[:3, 3])
            self._reach_for(pose)
        return bool(self._coming)

    def _reach_for(self, flange: Array) -> None:
        if flange[0, 3] > self.reach:
            self.stopped, self._coming = True, []
            raise self._refusal("cartesian_motion_generator_joint_position_limits_violation")
        self.flange = flange


class FakeGateway:
    """Takes `StreamPoints` calls as gRPC does, reading the requests in a thread of its own: a sample for each tip pose.

    Attributes:
        ground: m in base, the height of what the finger sees everywhere; it measures from 1 to 10 cm.
        device: what the first request named.
        told: (time, base_T_tip) of every tip pose.
    """

    def __init__(self, ground: float = 0.01) -> None:
        self.ground = ground
        self.device = ""
        self.told: list[tuple[float, Array]] = []

    def StreamPoints(self, requests: Iterable[Any]) -> Iterator[pb.StreamPointsResponse]:
        for request in requests:
            self.device = request.device or self.device
            told = [(pose.t, np.array(pose.base_t_tip.matrix).reshape(4, 4)) for pose in request.tip_poses]
            self.told += told
            if told:
                yield self._answer(told)

    def _answer(self, told: list[tuple[float, Array]]) -> pb.StreamPointsResponse:
        t, poses = np.array([t for t, _ in told]), np.stack([pose for _, pose in told])
        metres = (poses[:, 2, 3] - self.ground) / -poses[:, 2, 2]
        status = np.where(metres < 0.01, RANGE_UNDERFLOW, np.where(metres > 0.1, 7, 0))
        ranges = np.where(status == 0, metres, np.nan)
        samples = RangeSamples(t, poses, ranges, status, np.zeros(len(t), dtype=np.int64))
        return pb.StreamPointsResponse(samples=samples_to_proto(samples))


def _matrix(xyz: Any, rotation_vector: Any) -> Array:
    return Pose.from_rotation_vector(rotation_vector, xyz[:3]).matrix
