"""The SDK's gateway clients, and the examples of calling the gateway, with a finger behind a real pty."""

from __future__ import annotations

import asyncio
import json
import re
import sys
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from pretouch_orchestrator.rest.app import create_rest_app
from pretouch_orchestrator.upstream.addresses import Addresses
from pretouch_orchestrator.upstream.clients import GatewayClient as GatewayClientOfSessions
from pretouch_orchestrator.upstream.connection import UpstreamConnection
from pretouch_orchestrator.upstream.copies import Copies
from pretouch_orchestrator.upstream.devices import Devices
from pretouch_sensor_gateway.configuration import VARIABLE
from pretouch_sensor_gateway.service import running
from pretouch_simulation.finger_link import FingerProcess

from pretouch.channel import open_channel
from pretouch.client import AsyncGatewayClient, GatewayClient, Points
from pretouch.errors import Conflict, InvalidInput, NotFound
from pretouch.geometry import Pose
from pretouch.serving import ServiceContext, Settings, started
from pretouch.session import GatewaySpan
from pretouch.trajectory import Trajectory
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceStub
from pretouch.wire.json_objects import pose_to_json

ROOT = Path(__file__).resolve().parents[2]
GUIDE = "docs/how-to/read-a-finger.md"
TIMEOUT = 120.0
DOWN = Pose.from_rotation_vector([np.pi, 0, 0], [0.4, 0.0, 0.05])
PLANE_FINGER = """
import numpy as np
from pretouch_simulation.finger_process import run

def measure(poses):  # the plane z = 0, seen without noise
    return -poses[:, 2, 3] / poses[:, 2, 2], np.zeros(len(poses), int)

run(measure, rate=100.0, seed=3)
"""


@pytest.fixture(scope="module")
def finger() -> Iterator[FingerProcess]:
    with FingerProcess([sys.executable, "-c", PLANE_FINGER]) as process:
        process.play(Trajectory(np.array([0.0, 600.0]), np.tile(DOWN.matrix, (2, 1, 1))))
        yield process


@pytest.fixture
async def address(finger: FingerProcess, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[str]:
    """Of a gateway whose finger streams."""
    monkeypatch.setenv(VARIABLE, f"finger={finger.port}")
    async with asyncio.timeout(TIMEOUT), started("gateway", running, Settings(grace=1.0)) as service:
        address = f"127.0.0.1:{service.port}"
        async with AsyncGatewayClient(address) as client:
            async for _ in client.ranges():
                break
        yield address


def robot_time() -> float:
    """A robot's clock that counts from its start and has nothing to do with Unix time."""
    return time.monotonic() + 100.0


def check(batches: list[Points], offset: float) -> None:
    points = np.concatenate([batch.points for batch in batches])
    assert len(points) > 50
    np.testing.assert_allclose(points, np.tile([0.4, 0.0, 0.0], (len(points), 1)), atol=1e-3)
    last = batches[-1]
    assert abs(last.clock_offset - offset) <= 4 * last.clock_offset_std + 1e-4
    assert 0 < last.clock_offset_std < 0.05


async def test_the_asynchronous_client_reads_a_finger_by_a_robots_own_clock(address: str) -> None:
    async def poses() -> AsyncIterator[tuple[float, Pose]]:
        for _ in range(100):
            yield robot_time(), DOWN
            await asyncio.sleep(0.01)

    async with AsyncGatewayClient(address) as client:
        (device,) = await client.devices()
        assert (device.name, device.state) == ("finger", pb.DEVICE_STATE_STREAMING)
        status = await client.status("finger")
        assert abs(status.now - time.time()) < 10
        assert [module.range_status for module in status.modules] == [pb.RANGE_STATUS_GOOD]
        configuration = await client.configure(tip_T_module=[Pose.identity()])
        assert len(configuration.tip_t_module) == 1
        begun = time.time()
        batches = [batch async for batch in client.points(poses(), clock=robot_time)]
        check(batches, robot_time() - time.time())
        samples = await client.samples(begun, time.time())
        assert len(samples) == sum(len(batch.samples) for batch in batches)
        with pytest.raises(NotFound, match="thumb"):
            await client.status("thumb")
        with pytest.raises(InvalidInput, match="no folder"):
            await client.configure(recording=True)


async def test_the_synchronous_client_reads_a_finger_by_a_robots_own_clock(address: str) -> None:
    def poses() -> Iterator[tuple[float, Any]]:
        for _ in range(100):
            yield robot_time(), DOWN.matrix
            time.sleep(0.01)

    def read() -> None:
        with GatewayClient(address) as client:
            (device,) = client.devices()
            batch = next(iter(client.ranges(device.name)))
            np.testing.assert_allclose(batch.range, 0.05, atol=1e-3)
            assert (batch.range_status == pb.RANGE_STATUS_GOOD).all()
            check(list(client.points(poses(), clock=robot_time)), robot_time() - time.time())
            with pytest.raises(InvalidInput, match="not within"):
                list(client.points([(1.0, DOWN)]))
            with pytest.raises(ValueError, match="of mine"):
                list(client.points(iter(failing())))
        with pytest.raises(Conflict, match="closed"):
            client.devices()

    await asyncio.to_thread(read)


def failing() -> Iterator[tuple[float, Pose]]:
    yield time.time(), DOWN
    raise ValueError("a defect of mine")


async def test_the_guides_examples_run(address: str) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / GUIDE).read_text(), re.DOTALL)
    assert len(blocks) == 3

    async def run(code: str) -> str:
        program = await asyncio.create_subprocess_exec(
            *(sys.executable, "-c", code.replace("127.0.0.1:50053", address)),
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )
        out, errors = await program.communicate()
        assert program.returncode == 0, errors.decode()
        return out.decode()

    ranges, points, raw = await asyncio.gather(*map(run, blocks))
    assert ranges.startswith("finger reads well\n")
    assert ranges.count(": 50.0 mm") >= 5
    assert len(re.findall(r"^0\.4000 -?0\.0000 -?0\.000\d m, ", points, re.MULTILINE)) > 50
    assert int(re.findall(r"(\d+) samples", points)[0]) > 50
    assert sum(map(int, re.findall(r"(\d+) points", raw))) > 30


async def test_a_robot_without_grpc_sends_its_poses_over_rest(address: str) -> None:
    def connect(where: str) -> UpstreamConnection:
        channel = open_channel(where)
        return UpstreamConnection("sensor gateway", where, channel, SensorGatewayServiceStub(channel))

    async def lines() -> AsyncIterator[bytes]:
        pose = pose_to_json(DOWN)
        for _ in range(60):
            yield json.dumps({"t": robot_time(), "base_T_tip": pose}).encode() + b"\n"
            await asyncio.sleep(0.02)

    gateway = Copies("sensor gateway", Addresses((address,)), connect)
    context = ServiceContext("orchestrator", Settings())
    app = create_rest_app(None, context, None, devices=Devices(gateway))  # type: ignore[arg-type]
    transport = httpx.ASGITransport(app)
    async with gateway.opened(), httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client:
        asked = robot_time()
        now = (await client.get("/v1/devices/finger")).json()["now"]
        offset = (asked + robot_time()) / 2 - now
        start = robot_time() - offset
        answer = await client.post(
            "/v1/devices/finger/poses",
            params={"clock_offset": offset},
            headers={"Content-Type": "application/x-ndjson"},
            content=lines(),
        )
        report = answer.json()
        assert (answer.status_code, report["poses"], report["out_of_order"]) == (200, 60, 0), report
        samples = await GatewayClientOfSessions(gateway).get_samples(
            GatewaySpan("finger", start, robot_time() - offset)
        )
        assert len(samples) == report["samples"] > 50
        refused = await client.post(
            "/v1/devices/finger/poses", headers={"Content-Type": "application/x-ndjson"}, content=lines()
        )
        assert (refused.status_code, "600 s" in refused.json()["detail"]) == (422, True)
        assert "clock_offset" in refused.json()["remedy"]
    context.close()
