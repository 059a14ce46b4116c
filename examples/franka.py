"""A Franka arm corrects an object's pose with the range sensor in its fingertip (`pip install franky-control`)."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from franky import (
    Affine,
    CartesianMotion,
    CartesianState,
    CartesianWaypoint,
    CartesianWaypointMotion,
    ControlException,
    Duration,
    RobotPose,
    RobotVelocity,
    Twist,
)
from franky import Robot as FrankyRobot

from pretouch.camera import Camera
from pretouch.channel import open_sync_channel
from pretouch.client import Guard, Reflex, RestClient, add_descent, drive
from pretouch.geometry import Array, Pose
from pretouch.session import GatewaySpan, ScanPlan, ScanSettings, SessionRequest, Skipped, Submission
from pretouch.trajectory import Trajectory
from pretouch.v1.common_pb2 import Pose as PoseMessage
from pretouch.v1.sensor_gateway_pb2 import StreamPointsRequest, TipPose
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceStub

DEVICE = "finger"
TRAVEL_HEIGHT = 0.40  # m, z in base: above all that stands on the table
EE_T_TIP = Pose.of(np.eye(3), [0.0, 0.0, 0.05])  # the sensor in the end effector's frame of Desk, m; its z is the beam
PERIOD = 0.005  # s
LIFT_STEP = 0.001  # m; a lift that changes by less leaves the motion as it is


class Unreachable(Exception):
    """The arm stopped before it was there: a joint at its limit, or out of reach."""


class Robot:
    """Its poses are those of the end effector in base, as affine maps: m."""

    def __init__(self, host: str) -> None:
        self._robot = FrankyRobot(host)
        self._robot.relative_dynamics_factor = 0.1

    def base_T_tip(self) -> Array:
        return (Pose(self._robot.current_pose.end_effector_pose.matrix) @ EE_T_TIP).matrix

    def move_to(self, pose: Array) -> None:
        motion = CartesianMotion(CartesianState(RobotPose(Affine(pose))), ee_frame=Affine(EE_T_TIP.matrix))
        with self._noticing_stops():
            self._robot.move(motion, asynchronous=True)
            while self._robot.poll_motion():  # raises what stopped the motion
                time.sleep(PERIOD)

    def follow(self, path: Trajectory, guard: Guard) -> None:
        begun, lift = time.monotonic(), np.inf
        with self._noticing_stops():
            while lift == np.inf or self._robot.poll_motion():
                now = path.t[0] + time.monotonic() - begun
                if abs(guard.reflex.lift - lift) > LIFT_STEP and now < path.t[-1]:
                    reflex = guard.reflex
                    lift = reflex.lift
                    self._robot.move(_remaining(path, now, reflex), asynchronous=True)  # takes over from the one before
                time.sleep(PERIOD)

    @contextmanager
    def _noticing_stops(self) -> Iterator[None]:
        try:
            yield
        except ControlException as error:
            self._robot.recover_from_errors()
            raise Unreachable from error


def _remaining(path: Trajectory, now: float, reflex: Reflex) -> CartesianWaypointMotion:
    """What is left of the path from time `now` on, lifted as the reflex says."""
    velocities = np.gradient(path.base_T_tip[:, :3, 3], path.t, axis=0)
    velocities[-1] = 0.0
    left = path.t > now
    waypoints = [
        CartesianWaypoint(
            CartesianState(RobotPose(Affine(reflex.raise_tip(pose))), RobotVelocity(Twist(velocity))),
            minimum_time=Duration(round(1000 * seconds)),
        )
        for pose, velocity, seconds in zip(
            path.base_T_tip[left], velocities[left], np.diff(path.t[left], prepend=now), strict=True
        )
    ]
    return CartesianWaypointMotion(waypoints, ee_frame=Affine(EE_T_TIP.matrix))


def above(pose: Array) -> Array:
    """The pose drawn back along the beam up to TRAVEL_HEIGHT."""
    raised, beam = pose.copy(), pose[:3, 2]
    raised[:3, 3] += (TRAVEL_HEIGHT - pose[2, 3]) / beam[2] * beam
    return raised


def scan(robot: Robot, gateway: SensorGatewayServiceStub, plan: ScanPlan) -> Submission:
    """Makes the planned scan while the gateway is told where the tip is, and names the samples that it keeps.

    On the way down and along the path, a reflex lifts the tip where the gateway hears of something too near.
    """
    path = add_descent(plan.path)
    arrived = threading.Event()

    def tell() -> Iterator[StreamPointsRequest]:
        yield StreamPointsRequest(device=DEVICE)
        while not arrived.wait(0.01):
            pose = PoseMessage(matrix=robot.base_T_tip().ravel())
            yield StreamPointsRequest(tip_poses=[TipPose(t=time.time(), base_t_tip=pose)])

    try:
        robot.move_to(above(path.base_T_tip[0]))
        robot.move_to(path.base_T_tip[0])
        guard = Guard(gateway.StreamPoints(tell()))
        start = time.time() - path.t[0]  # after the descent
        try:
            robot.follow(path, guard)
        finally:
            end = time.time()
            arrived.set()
            robot.move_to(above(robot.base_T_tip()))
    except Unreachable:
        robot.move_to(above(robot.base_T_tip()))
        return Skipped()
    guard.finish()
    return GatewaySpan(DEVICE, start, end)


def main() -> None:
    request = SessionRequest(
        camera=Camera(fx=615.0, fy=615.0, cx=319.5, cy=239.5),  # of the depth image, in pixels
        base_T_camera=Pose(np.loadtxt("base_T_camera.txt")),  # 4x4, from your hand-eye calibration
        depth_scale=0.001,  # m of one unit of the depth image
        scan=ScanSettings(guarded=True),  # paths rely on the reflex that lifts the tip in `follow`
    )
    robot = Robot("172.16.0.2")
    with RestClient("http://127.0.0.1:8080") as client, open_sync_channel("127.0.0.1:50053") as channel:
        gateway = SensorGatewayServiceStub(channel)
        session = client.create_session(request, "depth.png")  # or the camera's array: (h, w), uint16 or float32
        for state in drive(client, session, lambda plan: scan(robot, gateway, plan)):
            print(f"{state.state}: {1000 * state.estimate.expected_error:.1f} mm expected")
    if state.reason is not None:
        print(state.reason["detail"], state.reason["remedy"])
    print("base_T_correction, which maps a point from where the camera put it to where it is:")
    print(state.estimate.base_T_correction.matrix)


if __name__ == "__main__":
    main()
