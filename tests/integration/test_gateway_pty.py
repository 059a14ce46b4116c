"""The gateway over real gRPC, with a finger behind a real pty: frames in, ranges, samples and points out."""

from __future__ import annotations

import asyncio
import math
import sys
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from grpc.aio import AioRpcError
from helpers.gateway_recordings import MODULES, T0, files_in, made_configuration, measured, series_in
from helpers.hand_finger import HandFinger
from pretouch_sensor_gateway.configuration import VARIABLE
from pretouch_sensor_gateway.device import Device
from pretouch_sensor_gateway.range_batch import RangeBatch
from pretouch_sensor_gateway.recording.queue_items import ConfigurationItem, StopItem
from pretouch_sensor_gateway.service import running
from pretouch_sensor_gateway.subscription_queue import QUEUE_MEASUREMENTS
from pretouch_simulation.finger_link import FingerProcess

from pretouch.channel import open_channel
from pretouch.errors import InvalidInput, NotFound, PretouchError, Unavailable, from_rpc_error
from pretouch.geometry import Pose
from pretouch.serving import Settings, started
from pretouch.trajectory import Trajectory
from pretouch.v1 import common_pb2
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceStub
from pretouch.wire.common import array_from_proto, pose_from_proto, pose_to_proto, samples_from_proto

TIMEOUT = 120.0  # of each whole conversation: only a hang takes so long
PLANE_FINGER = """
import numpy as np
from pretouch_simulation.finger_process import run

def measure(poses):  # the plane z = 0, seen without noise up to 10 cm
    ranges = -poses[:, 2, 3] / poses[:, 2, 2]
    seen = (ranges > 0.01) & (ranges <= 0.1)
    return np.where(seen, ranges, np.nan), np.where(seen, 0, 7)

run(measure, rate=200.0, seed=3)
"""


@asynccontextmanager
async def gateway(monkeypatch: pytest.MonkeyPatch, **ports: str | Path) -> AsyncIterator[tuple[Any, Any]]:
    monkeypatch.setenv(VARIABLE, ",".join(f"{name}={port}" for name, port in ports.items()))
    async with (
        asyncio.timeout(TIMEOUT),
        started("gateway", running, Settings(grace=1.0)) as service,
        open_channel(f"127.0.0.1:{service.port}") as channel,
    ):
        yield SensorGatewayServiceStub(channel), service.context


async def device_until(stub: Any, wanted: Callable[[pb.Device], bool]) -> pb.Device:
    while True:
        (device,) = (await stub.ListDevices(pb.ListDevicesRequest())).devices
        if wanted(device):
            return device
        await asyncio.sleep(0.01)


async def opened(stub: Any) -> None:
    """Until the only device's port is open: a pty forgets what was sent before."""
    while True:
        if (await stub.GetStatus(pb.GetStatusRequest())).connections:
            return
        await asyncio.sleep(0.01)


@pytest.fixture(scope="module")
def plane_finger() -> Any:
    with FingerProcess([sys.executable, "-c", PLANE_FINGER]) as finger:
        yield finger


def bobbing(seconds: float, rate: float = 100.0) -> Trajectory:
    """Beam down, tilting, along x at 5 cm/s while rising and sinking at up to 5 cm/s: a pose at a wrong time shows."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    poses = [
        Pose.from_rotation_vector(
            [math.pi - 0.1 * math.sin(3 * s), 0, 0], [0.05 * s, 0, 0.05 + 0.02 * math.sin(2.5 * s)]
        )
        for s in t
    ]
    return Trajectory(t, np.stack([pose.matrix for pose in poses]))


def tip_poses(trajectory: Trajectory, start: float) -> list[pb.TipPose]:
    return [
        pb.TipPose(t=start + t, base_t_tip=pose_to_proto(Pose(matrix)))
        for t, matrix in zip(trajectory.t, trajectory.base_T_tip, strict=True)
    ]


async def test_points_lie_on_the_plane_while_the_tip_moves_and_can_be_asked_for_again(
    plane_finger: FingerProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    motion = bobbing(1.5)
    async with gateway(monkeypatch, finger=plane_finger.port) as (stub, _):
        await device_until(stub, lambda device: device.state == pb.DEVICE_STATE_STREAMING)
        start = time.time() + 0.3
        plane_finger.play(motion, start)

        async def requests() -> AsyncIterator[pb.StreamPointsRequest]:
            yield pb.StreamPointsRequest(device="finger")
            poses = tip_poses(motion, start)
            for k in range(0, len(poses), 20):
                yield pb.StreamPointsRequest(tip_poses=poses[k : k + 20])

        batches = [batch async for batch in stub.StreamPoints(requests())]
        points = np.concatenate([array_from_proto(batch.points, "points") for batch in batches])
        samples = [samples_from_proto(batch.samples) for batch in batches]
        returned = np.isfinite(points[:, 2])
        assert returned.sum() > 250
        assert np.abs(points[returned, 2]).max() < 0.001
        assert sum(batch.lost for batch in batches) == 0
        t = np.concatenate([part.t for part in samples])
        assert (np.diff(t) > 0).all()
        assert t[0] >= start
        assert t[-1] <= start + motion.t[-1]

        request = pb.GetSamplesRequest(device="finger", to=start + 1.0, **{"from": start + 0.5})
        again = samples_from_proto((await stub.GetSamples(request)).samples)
        within = (t >= start + 0.5) & (t <= start + 1.0)
        np.testing.assert_array_equal(again.t, t[within])
        np.testing.assert_allclose(
            again.base_T_tip, np.concatenate([part.base_T_tip for part in samples])[within], atol=1e-9
        )


async def test_a_recording_of_six_modules_is_configured_as_it_was_and_gives_points(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    series_in(tmp_path).write(
        [ConfigurationItem(made_configuration(), T0), *(measured(k) for k in range(30)), StopItem()], 0.0
    )
    tip = pose_to_proto(Pose.identity())
    poses = [pb.TipPose(t=T0 + 0.1 * k, base_t_tip=tip) for k in range(-1, 12)]
    async with gateway(monkeypatch, finger=f"replay:{files_in(tmp_path)[0]}") as (stub, _):
        status = await stub.GetStatus(pb.GetStatusRequest())
        assert list(status.configuration.tip_t_module) == list(made_configuration().tip_t_module)

        async def requests() -> AsyncIterator[pb.StreamPointsRequest]:
            yield pb.StreamPointsRequest(device="finger", tip_poses=poses)

        points = np.concatenate(
            [array_from_proto(batch.points, "points") async for batch in stub.StreamPoints(requests())]
        )
        modules = [pose_from_proto(pose, "") for pose in made_configuration().tip_t_module]
        expected = [pose.apply([0.0, 0.0, 0.01 * (k + 1)]) for k, pose in enumerate(modules)][
            :-1
        ]  # the last one missed
        np.testing.assert_allclose(points[-MODULES:-1], expected, atol=1e-12)


async def test_ranges_come_as_they_are_measured(plane_finger: FingerProcess, monkeypatch: pytest.MonkeyPatch) -> None:
    still = Trajectory(
        np.array([0.0, 5.0]), np.tile(Pose.from_rotation_vector([math.pi, 0, 0], [0, 0, 0.04]).matrix, (2, 1, 1))
    )
    async with gateway(monkeypatch, finger=plane_finger.port) as (stub, _):
        seen: list[float] = []
        plane_finger.play(still)
        async for answer in stub.StreamRanges(pb.StreamRangesRequest()):
            ranges = array_from_proto(answer.batch.range, "range")
            status = array_from_proto(answer.batch.status, "status")
            assert ranges.shape[1] == 1
            assert (np.isnan(ranges) == (status == 7)).all()
            seen += ranges[status == 0].tolist()
            if len(seen) >= 50:
                break
        assert set(np.round(seen, 6)) == {0.04}


async def test_a_finger_that_is_unplugged_and_replugged_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = tmp_path / "finger"
    async with gateway(monkeypatch, finger=port) as (stub, _):
        absent = await device_until(stub, lambda device: bool(device.problem))
        assert absent.state == pb.DEVICE_STATE_CONNECTING
        assert "finger" in absent.problem

        stream = stub.StreamRanges(pb.StreamRangesRequest(device="finger"))
        finger = HandFinger(port)
        reader = asyncio.create_task(stream.read())
        sequence = 0
        while not reader.done():
            finger.measure(sequence)
            sequence += 1
            await asyncio.sleep(0.01)
        assert (await device_until(stub, lambda device: device.frames > 0)).state == pb.DEVICE_STATE_STREAMING

        finger.unplug()
        outage = await device_until(
            stub, lambda device: device.state == pb.DEVICE_STATE_CONNECTING and bool(device.problem)
        )
        sequence += 50  # it had power all the while
        finger = HandFinger(port)
        lost = 0
        while lost < 50:  # the same call goes on, and says what was missed
            finger.measure(sequence)
            sequence += 1
            try:
                async with asyncio.timeout(0.02):
                    lost += (await asyncio.shield(reader)).batch.lost
            except TimeoutError:
                continue
            reader = asyncio.create_task(stream.read())
        again = await device_until(stub, lambda device: device.frames > outage.frames)
        assert again.state == pb.DEVICE_STATE_STREAMING
        assert again.problem == ""
        reader.cancel()
        stream.cancel()
        finger.unplug()


async def test_corrupted_bytes_are_counted_and_passed_by(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    finger = HandFinger(tmp_path / "finger")
    async with gateway(monkeypatch, finger=tmp_path / "finger") as (stub, _):
        await opened(stub)
        stream = stub.StreamRanges(pb.StreamRangesRequest())
        await stream.initial_metadata()
        good = finger.frame(1)
        finger.measure(0)
        finger.send_bytes(good[:5] + bytes([good[5] ^ 0x10]) + good[6:])
        finger.send_bytes(b"\xff" * 1000 + b"\x00")
        finger.measure(2)
        sequences, lost = [], 0
        while 2 not in sequences:
            batch = (await stream.read()).batch
            sequences += array_from_proto(batch.sequence, "sequence").tolist()
            lost += batch.lost
        assert (sequences, lost) == ([0, 2], 1)
        device = await device_until(stub, lambda device: True)
        assert (device.frames, device.bad_frames, device.lost_frames) == (2, 2, 1)
        status = await stub.GetStatus(pb.GetStatusRequest())
        assert dict(status.refused) == {"checksum": 1, "oversize": 1}
        stream.cancel()
        finger.unplug()


async def test_a_slow_subscriber_is_told_its_losses(monkeypatch: pytest.MonkeyPatch) -> None:
    devices: list[Device] = []
    init = Device.__init__

    def noted(self: Device, *args: Any) -> None:
        init(self, *args)
        devices.append(self)

    def measured(sequence: int) -> RangeBatch:
        row, codes = np.full((1, 6), 0.03), np.zeros((1, 6), dtype=np.uint8)
        return RangeBatch(
            np.ones(1),
            0.001,
            np.array([sequence], dtype=np.uint32),
            0,
            row,
            row,
            codes,
            codes,
            0,
            row.astype(np.float32),
        )

    monkeypatch.setattr(Device, "__init__", noted)
    async with gateway(monkeypatch, finger="/dev/absent") as (stub, _):
        (device,) = devices
        stream = stub.StreamRanges(pb.StreamRangesRequest())
        await stream.initial_metadata()
        total = 60_000
        for sequence in range(total):
            device.deliver(measured(sequence))
            if sequence % (4 * QUEUE_MEASUREMENTS) == 0:  # more than a queue holds come before anybody can take them
                await asyncio.sleep(0)
        got = overrun = 0
        while got + overrun < total:
            answer = await stream.read()
            overrun += answer.overrun
            # what is missing lies before the batch
            assert array_from_proto(answer.batch.sequence, "sequence").tolist() == [got + overrun]
            got += 1
        assert got + overrun == total
        assert overrun > 0
        assert (await stub.GetStatus(pb.GetStatusRequest())).overrun == overrun

        for sequence in range(total, total + 20_000):  # and one that leaves while the gateway waits for it
            device.deliver(measured(sequence))
            if sequence % 50 == 0:
                await asyncio.sleep(0)
        assert device.status().subscribers == 1
        stream.cancel()
        while device.status().subscribers:
            await stub.ListDevices(pb.ListDevicesRequest())


async def test_a_device_is_configured_while_it_runs_and_its_status_tells(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    finger = HandFinger(tmp_path / "finger", modules=2)
    poses = [pose_to_proto(Pose.of(np.eye(3), [0.01 * k, 0, 0])) for k in range(2)]
    calibration = pb.Calibration(modules=[pb.ModuleCalibration(offset=0.01, scale=1.0, std=0.001)] * 2)
    async with gateway(monkeypatch, finger=tmp_path / "finger") as (stub, _):
        await opened(stub)
        stream = stub.StreamRanges(pb.StreamRangesRequest())
        await stream.initial_metadata()
        finger.measure(0, 0.05)
        before = (await stream.read()).batch
        answer = await stub.Configure(pb.ConfigureRequest(tip_t_module=poses, calibration=calibration))
        assert answer.configuration.calibration == calibration
        assert list(answer.configuration.tip_t_module) == poses
        finger.measure(1, 0.05)
        after = (await stream.read()).batch
        np.testing.assert_allclose(array_from_proto(before.range, "range"), [[0.05, 0.05]], atol=1e-9)
        np.testing.assert_allclose(array_from_proto(after.range, "range"), [[0.04, 0.04]], atol=1e-9)
        np.testing.assert_allclose(array_from_proto(after.raw, "raw"), [[0.05, 0.05]], atol=1e-9)

        status = await stub.GetStatus(pb.GetStatusRequest(device="finger"))
        assert status.configuration == answer.configuration
        assert (status.format, status.epoch, status.connections, status.subscribers) == ("binary", 0, 1, 1)
        assert (status.identity.serial, status.identity.firmware) == ("00000000000000aa", "hand 1.0")
        assert status.clock.synchronised
        assert 0 < status.clock.round_trip < 1
        assert [(module.measurements, module.returns, module.jumps) for module in status.modules] == [(2, 2, 0)] * 2
        assert status.modules[1].range == pytest.approx(0.04)
        assert not status.recording.on

        now = time.time()
        tips = [pb.TipPose(t=now + 0.2 * k, base_t_tip=pose_to_proto(Pose.identity())) for k in range(3)]
        call = stub.StreamPoints(iter([pb.StreamPointsRequest(tip_poses=tips)]))
        await call.initial_metadata()
        finger.measure(2, 0.05)
        fused = await call.read()
        np.testing.assert_allclose(array_from_proto(fused.points, "points"), [[0, 0, 0.04], [0.01, 0, 0.04]], atol=1e-9)
        np.testing.assert_allclose(array_from_proto(fused.std, "std"), 0.001, atol=1e-9)

        for request, said in (
            (pb.ConfigureRequest(recording=True), "no folder to record to"),
            (pb.ConfigureRequest(tip_t_module=[common_pb2.Pose()]), "tip_t_module[0]"),
            (pb.ConfigureRequest(calibration=pb.Calibration(modules=[pb.ModuleCalibration(scale=0)])), "scale"),
        ):
            error = await refused(stub.Configure(request))
            assert isinstance(error, InvalidInput)
            assert said in error.detail
        call.cancel()
        stream.cancel()
        finger.unplug()


async def refused(call: Any) -> PretouchError:
    with pytest.raises(AioRpcError) as caught:
        await call
    return from_rpc_error(caught.value)


async def test_what_cannot_be_answered_is_refused_with_a_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = pose_to_proto(Pose.identity())

    def points(*messages: pb.StreamPointsRequest) -> Any:
        return stub.StreamPoints(iter(messages)).read()

    async with gateway(monkeypatch, left=tmp_path / "a", right=tmp_path / "b") as (stub, _):
        unknown = await refused(stub.StreamRanges(pb.StreamRangesRequest(device="middle")).read())
        assert isinstance(unknown, NotFound)
        assert "left, right" in unknown.remedy
        now = time.time()
        for call, said in (
            (stub.StreamRanges(pb.StreamRangesRequest()).read(), "2 devices"),
            (stub.GetSamples(pb.GetSamplesRequest(device="left", to=1.0, **{"from": 2.0})), "not valid"),
            (stub.GetSamples(pb.GetSamplesRequest(device="left", to=math.nan)), "not valid"),
            (points(), "without a message"),
            (
                points(pb.StreamPointsRequest(device="left", tip_poses=[pb.TipPose(t=3.0, base_t_tip=here)])),
                "not within",
            ),
            (points(pb.StreamPointsRequest(device="left", tip_poses=[pb.TipPose(t=now)])), "16"),
            (
                points(
                    pb.StreamPointsRequest(device="left", tip_poses=[pb.TipPose(t=now, base_t_tip=here)]),
                    pb.StreamPointsRequest(clock_offset=1.0),
                ),
                "later message",
            ),
            (points(pb.StreamPointsRequest(device="left"), pb.StreamPointsRequest(device="right")), "later message"),
        ):
            error = await refused(call)
            assert isinstance(error, InvalidInput), error
            assert said in error.detail
            assert error.remedy
    async with gateway(monkeypatch) as (stub, _):
        assert not (await stub.ListDevices(pb.ListDevicesRequest())).devices
        assert isinstance(await refused(stub.StreamRanges(pb.StreamRangesRequest()).read()), NotFound)


async def test_a_call_whose_poses_end_ends_though_no_frame_comes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with gateway(monkeypatch, finger=tmp_path / "absent") as (stub, _):
        tip = pb.TipPose(t=time.time() - 5.0, base_t_tip=pose_to_proto(Pose.identity()))
        for messages in ([pb.StreamPointsRequest(tip_poses=[tip])], [pb.StreamPointsRequest()]):
            assert [batch async for batch in stub.StreamPoints(iter(messages))] == []


async def test_streams_end_when_the_gateway_stops(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def nothing_more() -> AsyncIterator[pb.StreamPointsRequest]:
        yield pb.StreamPointsRequest()
        await asyncio.Event().wait()

    async with asyncio.timeout(TIMEOUT):
        monkeypatch.setenv(VARIABLE, f"finger={tmp_path / 'absent'}")
        service = started("gateway", running, Settings(grace=30.0))
        begun = await service.__aenter__()
        async with open_channel(f"127.0.0.1:{begun.port}") as channel:
            stub = SensorGatewayServiceStub(channel)
            calls = [stub.StreamRanges(pb.StreamRangesRequest()), stub.StreamPoints(nothing_more())]
            reads = [asyncio.create_task(refused(call.read())) for call in calls]
            for call in calls:
                await call.initial_metadata()
            await service.__aexit__(None, None, None)
            assert all(isinstance(error, Unavailable) for error in await asyncio.gather(*reads))


async def test_prometheus_sees_the_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    finger = HandFinger(tmp_path / "finger")
    async with gateway(monkeypatch, finger=tmp_path / "finger") as (stub, context):
        await opened(stub)
        finger.measure(0)
        await device_until(stub, lambda device: device.frames == 1)
        finger.send_bytes(b"\x05\x00")
        await device_until(stub, lambda device: device.bad_frames == 1)
        count = context.metrics.registry.get_sample_value
        assert count("pretouch_gateway_frames_total", {"device": "finger"}) == 1
        assert count("pretouch_gateway_bad_frames_total", {"device": "finger"}) == 1
        finger.unplug()
