"""A UFACTORY xArm corrects an object's pose with the range sensor in its fingertip (`pip install xarm-python-sdk`)."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import numpy as np
from xarm.wrapper import XArmAPI

from pretouch.camera import Camera
from pretouch.channel import open_sync_channel
from pretouch.client import Guard, RestClient, add_descent, drive
from pretouch.geometry import Array, Pose, vector_from_rotation
from pretouch.session import GatewaySpan, ScanPlan, ScanSettings, SessionRequest, Skipped, Submission
from pretouch.trajectory import Trajectory
from pretouch.v1.common_pb2 import Pose as PoseMessage
from pretouch.v1.sensor_gateway_pb2 import StreamPointsRequest, TipPose
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceStub

DEVICE = "finger"
TRAVEL_HEIGHT = 0.40  # m, z in base: above all that stands on the table
FLANGE_T_TIP = Pose.of(np.eye(3), [0.0, 0.0, 0.14])  # the sensor on the flange, m; its z is the beam
PERIOD = 0.01  # s


class Robot:
    """Its poses are (x, y, z, rx, ry, rz) of the flange in base: mm, and a rotation vector, here in rad."""

    def __init__(self, host: str) -> None:
        self._arm = XArmAPI(host, is_radian=True)
        self._arm.motion_enable(True)
        _check(self._arm.set_tcp_offset([0.0] * 6))  # poses are the flange's from here on
        self._enter_mode(0)

    def base_T_tip(self) -> Array:
        code, pose = self._arm.get_position_aa(is_radian=True)
        _check(code)
        return (Pose.from_rotation_vector(pose[3:], np.array(pose[:3]) / 1000) @ FLANGE_T_TIP).matrix

    def can_reach(self, pose: Array) -> bool:
        base_T_flange = (Pose(pose) @ FLANGE_T_TIP.inverse()).matrix
        roll = np.arctan2(base_T_flange[2, 1], base_T_flange[2, 2])
        pitch = np.arcsin(-base_T_flange[2, 0])
        yaw = np.arctan2(base_T_flange[1, 0], base_T_flange[0, 0])
        xyz = 1000 * base_T_flange[:3, 3]
        code, _ = self._arm.get_inverse_kinematics([*xyz.tolist(), roll, pitch, yaw], input_is_radian=True)
        return bool(code == 0)

    def move_to(self, pose: Array) -> None:
        code = self._arm.set_position_aa(_vector(pose), speed=100, mvacc=500, is_radian=True, wait=True)  # mm/s, mm/s^2
        _check(code)

    def follow(self, path: Trajectory, guard: Guard) -> None:
        self._enter_mode(1)  # servo motion
        begun = time.monotonic()
        try:
            while (now := time.monotonic() - begun) < path.duration:
                target = guard.reflex.raise_tip(path.at([path.t[0] + now])[0])
                _check(self._arm.set_servo_cartesian_aa(_vector(target), is_radian=True))
                time.sleep(PERIOD)
        finally:
            self._enter_mode(0)  # position control

    def _enter_mode(self, mode: int) -> None:
        _check(self._arm.set_mode(mode))
        _check(self._arm.set_state(0))
        time.sleep(0.1)


def _vector(base_T_tip: Array) -> list[float]:
    base_T_flange = Pose(base_T_tip) @ FLANGE_T_TIP.inverse()
    return [*(1000 * base_T_flange.translation).tolist(), *vector_from_rotation(base_T_flange.rotation).tolist()]


def _check(code: int) -> None:
    if code != 0:
        raise RuntimeError(f"The arm answered with code {code}; see the SDK's xarm_api_code.md.")


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
    first, last = path.base_T_tip[0], path.base_T_tip[-1]
    if not all(robot.can_reach(pose) for pose in [above(first), *path.base_T_tip, above(last)]):
        return Skipped()
    arrived = threading.Event()

    def tell() -> Iterator[StreamPointsRequest]:
        yield StreamPointsRequest(device=DEVICE)
        while not arrived.wait(0.01):
            pose = PoseMessage(matrix=robot.base_T_tip().ravel())
            yield StreamPointsRequest(tip_poses=[TipPose(t=time.time(), base_t_tip=pose)])

    robot.move_to(above(first))
    robot.move_to(first)
    guard = Guard(gateway.StreamPoints(tell()))
    start = time.time() - path.t[0]  # after the descent
    try:
        robot.follow(path, guard)
    finally:
        end = time.time()
        arrived.set()
        robot.move_to(above(robot.base_T_tip()))
    guard.finish()
    return GatewaySpan(DEVICE, start, end)


def main() -> None:
    request = SessionRequest(
        camera=Camera(fx=615.0, fy=615.0, cx=319.5, cy=239.5),  # of the depth image, in pixels
        base_T_camera=Pose(np.loadtxt("base_T_camera.txt")),  # 4x4, from your hand-eye calibration
        depth_scale=0.001,  # m of one unit of the depth image
        scan=ScanSettings(guarded=True),  # paths rely on the reflex that lifts the tip in `follow`
    )
    robot = Robot("192.168.1.185")
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
