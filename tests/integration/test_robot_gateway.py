"""The simulated robot scans with a finger on a serial line: a real gateway process, a real pty, poses as it moves."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from helpers.processes import Service, free_port
from pretouch_simulation.finger_link import FingerProcess
from pretouch_simulation.robot import GatewayRobot

from pretouch.channel import open_sync_channel
from pretouch.errors import NotFound, Unauthenticated, Unavailable
from pretouch.geometry import Pose
from pretouch.session import ScanPlan
from pretouch.trajectory import Trajectory
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceStub
from pretouch.wire.common import samples_from_proto

RATE = 200.0
PACE = 4.0
SLOPE_FINGER = """
import numpy as np
from pretouch_simulation.finger_process import run

def measure(poses):  # the slope z = x / 2 under a vertical beam
    return poses[:, 2, 3] - 0.5 * poses[:, 0, 3], np.zeros(len(poses), dtype=np.int64)

run(measure, rate=200.0, seed=5)
"""


@dataclass
class Line:
    """A finger, and the gateway that listens to it."""

    finger: FingerProcess
    gateway: Service


@pytest.fixture(scope="module")
def line() -> Iterator[Line]:
    with FingerProcess([sys.executable, "-c", SLOPE_FINGER]) as finger:
        devices = f"finger={finger.port},loose=/dev/pretouch-nothing-here"
        gateway = Service("gateway", free_port(), {"PRETOUCH_GATEWAY_DEVICES": devices, "PRETOUCH_TOKEN": "secret"})
        gateway.start()
        try:
            yield Line(finger, gateway)
        finally:
            gateway.stop()


def plan(scan_id: str, x: float) -> ScanPlan:
    """10 cm along x at 5 cm/s, the beam straight down; the tip rises from 4 to 6 cm."""
    down = np.diag([1.0, -1.0, -1.0])
    poses = np.stack([Pose.of(down, [x, 0.1, 0.04]).matrix, Pose.of(down, [x + 0.1, 0.1, 0.06]).matrix])
    return ScanPlan(scan_id, "region-1", "region-1", Trajectory(np.array([0.0, 2.0]), poses), 1.0)


def test_samples_lie_on_the_path_and_tell_the_slope(line: Line) -> None:
    with GatewayRobot(line.finger, line.gateway.address, "finger", PACE, token="secret") as robot:
        for scan, x in (("scan-1", 0.0), ("scan-2", -0.05)):
            samples = robot.scan(plan(scan, x))
            seconds = 2.0 / PACE
            assert len(samples) >= 0.9 * seconds * RATE
            assert (samples.status == 0).all()
            assert (np.diff(samples.t) > 0).all()
            tips = samples.base_T_tip[:, :3, 3]
            assert tips[:, 0].min() == pytest.approx(x, abs=0.01)
            assert tips[:, 0].max() == pytest.approx(x + 0.1, abs=0.01)
            # The tip moves at 20 cm/s, so that a millisecond's error of the clocks is 0.2 mm.
            np.testing.assert_allclose(samples.range, tips[:, 2] - 0.5 * tips[:, 0], atol=1e-3)
    first, second = robot.motions
    np.testing.assert_array_equal(second.path.base_T_tip[0], first.path.base_T_tip[-1])


def test_spans_name_what_the_gateway_keeps(line: Line) -> None:
    with GatewayRobot(line.finger, line.gateway.address, "finger", PACE, token="secret") as robot:
        *earlier, span = robot.stream_spans(plan("scan-1", 0.0))
    assert span.device == "finger"
    assert span.end - span.start == pytest.approx(2.0 / PACE, abs=2 / RATE)
    assert [each.start for each in earlier] == [span.start] * len(earlier)
    assert all(each.end < span.end for each in earlier)
    with open_sync_channel(line.gateway.address, "secret") as channel:
        request = pb.GetSamplesRequest(device="finger", to=span.end, **{"from": span.start})
        samples = samples_from_proto(SensorGatewayServiceStub(channel).GetSamples(request, timeout=30).samples)
    assert len(samples) >= 0.9 * 2.0 / PACE * RATE
    tips = samples.base_T_tip[:, :3, 3]
    np.testing.assert_allclose(samples.range, tips[:, 2] - 0.5 * tips[:, 0], atol=1e-3)


def test_a_robot_that_is_stopped_leaves_the_path_at_once(line: Line) -> None:
    with GatewayRobot(line.finger, line.gateway.address, "finger", 1.0, token="secret") as robot:
        flight = robot.stream(plan("scan-1", 0.0))
        first = next(flight)
        flight.close()
        following = robot.scan(plan("scan-2", 0.0))
    assert first.t[-1] - first.t[0] < 1.0
    stopped, _ = robot.motions
    assert stopped.end - stopped.start < 2.0
    np.testing.assert_array_equal(robot.measured[0].t, first.t)
    tips = following.base_T_tip[:, :3, 3]
    assert len(following) >= 0.9 * 2.0 * RATE
    np.testing.assert_allclose(following.range, tips[:, 2] - 0.5 * tips[:, 0], atol=1e-3)


def test_a_finger_that_is_not_heard_is_named(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pretouch_simulation.robot._PATIENCE", 0.5)
    with (
        pytest.raises(Unavailable, match="'loose'"),
        GatewayRobot(line.finger, line.gateway.address, "loose", token="secret"),
    ):
        pass
    with (
        pytest.raises(Unauthenticated),
        GatewayRobot(line.finger, line.gateway.address, "finger", token="guess"),
    ):
        pass


def test_an_unknown_device_is_refused_when_it_is_scanned_with(line: Line) -> None:
    robot = GatewayRobot(line.finger, line.gateway.address, "thumb", PACE, token="secret")
    with pytest.raises(NotFound, match="thumb"):
        robot.scan(plan("scan-1", 0.0))
    robot.__exit__()
