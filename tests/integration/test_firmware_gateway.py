"""The whole way: the firmware's six modules behind a pty, through the gateway, to a subscriber and to points."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator, Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.firmware_bench import MODULES, Bench, make, need
from pretouch_sensor_gateway.configuration import DeviceSetting, GatewaySetting
from pretouch_sensor_gateway.service import serve

from pretouch.channel import open_channel
from pretouch.geometry import Pose
from pretouch.serving import Settings, started
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceStub
from pretouch.wire.common import array_from_proto, pose_to_proto

TIMEOUT = 120.0  # of the whole conversation: only a hang takes so long
RANGES = (20, 30, 40, 50, 60, 70)


@pytest.fixture
def bench(tmp_path: Path) -> Any:
    need("make", "cc")
    make(f"{tmp_path}/finger-host", tmp_path)
    with Bench(tmp_path / "finger-host") as bench:
        for module, millimetres in enumerate(RANGES):
            bench.tell(f"see {module} {millimetres} 0")
        yield bench


async def batch_where(stream: Any, wanted: Callable[[np.ndarray[Any, Any], np.ndarray[Any, Any]], bool]) -> Any:
    """The first batch whose last ranges (m) and status codes are wanted."""
    while True:
        batch = (await stream.read()).batch
        if wanted(array_from_proto(batch.range, "range")[-1], array_from_proto(batch.status, "status")[-1]):
            return batch


async def test_six_modules_stream_one_is_unplugged_and_the_board_restarts(bench: Bench) -> None:
    seen = np.array(RANGES) / 1000.0
    modules = tuple(Pose.of(np.eye(3), [0.01 * k, 0, 0]) for k in range(MODULES))
    setting = GatewaySetting((DeviceSetting("finger", str(bench.port), tip_T_module=modules),))
    async with (
        asyncio.timeout(TIMEOUT),
        started("gateway", partial(serve, setting=setting), Settings(grace=1.0)) as service,
        open_channel(f"127.0.0.1:{service.port}") as channel,
    ):
        stub = SensorGatewayServiceStub(channel)
        stream = stub.StreamRanges(pb.StreamRangesRequest())
        await batch_where(stream, lambda ranges, status: np.array_equal(np.round(ranges, 6), seen))

        async def poses() -> AsyncIterator[pb.StreamPointsRequest]:
            down = pose_to_proto(Pose.from_rotation_vector([math.pi, 0, 0], [0, 0, 0.1]))
            now = time.time()
            tips = [pb.TipPose(t=now + 0.2 * k, base_t_tip=down) for k in range(6)]
            yield pb.StreamPointsRequest(tip_poses=tips)

        batches = [batch async for batch in stub.StreamPoints(poses())]
        points = np.concatenate([array_from_proto(batch.points, "points") for batch in batches])
        assert len(points) >= 20 * MODULES
        np.testing.assert_allclose(points[:, 2], np.tile(0.1 - seen, len(points) // MODULES), atol=1e-9)
        np.testing.assert_allclose(points[:MODULES, 0], 0.01 * np.arange(MODULES), atol=1e-9)

        bench.tell("unplug 2")
        gone = await batch_where(stream, lambda ranges, status: status[2] == 255)
        assert np.isnan(array_from_proto(gone.range, "range")[-1, 2])
        np.testing.assert_allclose(np.delete(array_from_proto(gone.range, "range")[-1], 2), np.delete(seen, 2))
        bench.tell("plug 2")
        await batch_where(stream, lambda ranges, status: status[2] == 0)

        bench.tell("reboot")
        while (batch := (await stream.read()).batch).epoch == 0:
            pass
        assert array_from_proto(batch.sequence, "sequence")[0] == batch.lost
        status = await stub.GetStatus(pb.GetStatusRequest())
        assert status.epoch == 1
        assert status.identity.modules == MODULES
        assert status.identity.period == pytest.approx(0.03)
        assert status.device.problem == ""
        assert len(status.modules) == MODULES
        stream.cancel()
