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
from pretouch.client import RestClient, drive
from pretouch.geometry import Array, Pose, vector_from_rotation
from pretouch.session import GatewaySpan, ScanPlan, SessionRequest, Skipped, Submission
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

    def follow(self, path: Trajectory) -> None:
        begun = time.monotonic()
        while (now := time.monotonic() - begun) < path.duration:
            period = self._control.initPeriod()
            target = _vector(path.at([path.t[0] + now])[0])
            self._control.servoL(target, 0.0, 0.0, 1.0 / RATE, 0.1, 300.0)  # two unused, s, s of lookahead, gain
            self._control.waitPeriod(period)
        self._control.servoStop()


def _vector(pose: Array) -> list[float]:
    return [*pose[:3, 3].tolist(), *vector_from_rotation(pose[:3, :3]).tolist()]


def above(pose: Array) -> Array:
    """The pose drawn back along the beam up to TRAVEL_HEIGHT."""
    raised, beam = pose.copy(), pose[:3, 2]
    raised[:3, 3] += (TRAVEL_HEIGHT - pose[2, 3]) / beam[2] * beam
    return raised


def scan(robot: Robot, gateway: SensorGatewayServiceStub, plan: ScanPlan) -> Submission:
    """Makes the planned scan while the gateway is told where the tip is, and names the samples that it keeps."""
    first, last = plan.path.base_T_tip[0], plan.path.base_T_tip[-1]
    if not all(robot.can_reach(pose) for pose in [above(first), *plan.path.base_T_tip, above(last)]):
        return Skipped()
    arrived = threading.Event()

    def tell() -> Iterator[StreamPointsRequest]:
        yield StreamPointsRequest(device=DEVICE)
        while not arrived.wait(0.01):
            pose = PoseMessage(matrix=robot.base_T_tip().ravel())
            yield StreamPointsRequest(tip_poses=[TipPose(t=time.time(), base_t_tip=pose)])

    robot.move_to(above(first))
    robot.move_to(first)
    answers, start = gateway.StreamPoints(tell()), time.time()
    try:
        robot.follow(plan.path)
    finally:
        arrived.set()
    span = GatewaySpan(DEVICE, start, time.time())
    for _ in answers:
        pass  # until the last sample has its pose
    robot.move_to(above(last))
    return span


def main() -> None:
    request = SessionRequest(
        camera=Camera(fx=615.0, fy=615.0, cx=319.5, cy=239.5),  # of the depth image, in pixels
        base_T_camera=Pose(np.loadtxt("base_T_camera.txt")),  # 4x4, from your hand-eye calibration
        depth_scale=0.001,  # m of one unit of the depth image
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
