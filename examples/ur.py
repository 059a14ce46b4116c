"""A Universal Robots arm corrects an object's pose with the range sensor in its fingertip (`pip install ur-rtde`)."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import numpy as np
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

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
RATE = 125.0  # Hz


class Robot:
    """Its poses are (x, y, z, rx, ry, rz) of the tool centre point in base: m, and a rotation vector in rad."""

    def __init__(self, host: str) -> None:
        self._control = RTDEControlInterface(host, RATE)
        self._receive = RTDEReceiveInterface(host, RATE)
        self._control.setTcp(_vector(FLANGE_T_TIP.matrix))  # from here on the tool centre point is the sensor

    def base_T_tip(self) -> Array:
        vector = self._receive.getActualTCPPose()
        return Pose.from_rotation_vector(vector[3:], vector[:3]).matrix

    def can_reach(self, pose: Array) -> bool:
        return bool(self._control.isPoseWithinSafetyLimits(_vector(pose)))

    def move_to(self, pose: Array) -> None:
        if not self._control.moveL(_vector(pose), 0.1, 0.5):  # m/s, m/s^2
            raise RuntimeError("The arm did not arrive; look at its pendant.")

    def follow(self, path: Trajectory, guard: Guard) -> None:
        begun = time.monotonic()
        try:
            while (now := time.monotonic() - begun) < path.duration:
                period = self._control.initPeriod()
                target = guard.reflex.raise_tip(path.at([path.t[0] + now])[0])
                servo = 1.0 / RATE, 0.1, 300.0  # s, s of lookahead, gain
                self._control.servoL(_vector(target), 0.0, 0.0, *servo)  # speed and acceleration are unused
                self._control.waitPeriod(period)
        finally:
            self._control.servoStop()


def _vector(pose: Array) -> list[float]:
    return [*pose[:3, 3].tolist(), *vector_from_rotation(pose[:3, :3]).tolist()]


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
    robot = Robot("192.168.0.10")
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
