"""An example's robot program before the real gateway: the span that it names holds the samples of its scan."""

from __future__ import annotations

import importlib
import sys

import numpy as np
import pytest
from helpers.arm_sdks import FakeXArm
from helpers.processes import Service, free_port
from pretouch_simulation.finger_link import FingerProcess

from pretouch.channel import open_sync_channel
from pretouch.geometry import Pose
from pretouch.session import GatewaySpan, ScanPlan
from pretouch.trajectory import Trajectory
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceStub
from pretouch.wire.common import samples_from_proto

RATE = 100.0
FINGER = f"""
from pretouch_simulation.finger_process import run

run(lambda poses: None, rate={RATE}, seed=5)
"""
"""It is told of no motion, so that all samples are misses: here their times and poses count."""


def test_the_gateway_keeps_the_samples_of_the_span(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("xarm.wrapper")
    example = importlib.import_module("examples.ufactory_xarm")
    monkeypatch.setattr(example, "XArmAPI", lambda *_, **__: FakeXArm())
    poses = [Pose.of(np.diag([1.0, -1.0, -1.0]), [x, 0.05, 0.06]).matrix for x in (0.50, 0.56)]
    plan = ScanPlan("scan-1", "line-1", None, Trajectory(np.array([0.0, 1.2]), np.stack(poses)), 1.0)
    with FingerProcess([sys.executable, "-c", FINGER]) as finger:
        gateway = Service("gateway", free_port(), {"PRETOUCH_GATEWAY_DEVICES": f"finger={finger.port}"})
        gateway.start()
        try:
            with open_sync_channel(gateway.address) as channel:
                stub = SensorGatewayServiceStub(channel)
                _wait_for_finger(stub)
                span = example.scan(example.Robot("192.0.2.1"), stub, plan)
                assert isinstance(span, GatewaySpan)
                fields = {"device": span.device, "from": span.start, "to": span.end}
                samples = samples_from_proto(stub.GetSamples(pb.GetSamplesRequest(**fields)).samples)
        finally:
            gateway.stop()
    assert len(samples) >= 0.8 * RATE * (span.end - span.start)
    tips = samples.base_T_tip[:, :3, 3]
    np.testing.assert_allclose(tips[:, 1], 0.05, atol=1e-6)
    descending = tips[:, 2] > 0.06 + 1e-6
    assert (np.diff(tips[descending, 2]) <= 0).all()  # the end of the guarded descent belongs to the scan
    assert descending.mean() < 0.3
    np.testing.assert_allclose(tips[~descending, 2], 0.06, atol=1e-6)
    assert tips[0, 0] < 0.505
    assert tips[-1, 0] > 0.555


def _wait_for_finger(stub: SensorGatewayServiceStub) -> None:
    """A gateway passes nothing on before it knows the device's clock."""
    for answer in stub.StreamRanges(pb.StreamRangesRequest(device="finger"), timeout=60):
        if len(answer.batch.t.data):
            return
    raise AssertionError("the gateway hears no finger")
