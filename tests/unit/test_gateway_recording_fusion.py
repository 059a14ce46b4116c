"""A recording stands in for the device: the same configuration, batches, tip poses and points, bit for bit."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import structlog
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from helpers.gateway_recordings import T0, files_in, made_configuration, recorded_in
from pretouch_sensor_gateway.calibration.model import Calibration, ModuleCalibration
from pretouch_sensor_gateway.calibration.proto_conversion import calibration_to_proto
from pretouch_sensor_gateway.device import Device
from pretouch_sensor_gateway.fusion import FusedSamples, fuse_span
from pretouch_sensor_gateway.point_stream import PointStream
from pretouch_sensor_gateway.range_batch import RangeBatch
from pretouch_sensor_gateway.recording.player import RecordingPlayer
from pretouch_sensor_gateway.recording.writer import RecordingWriter
from pretouch_sensor_gateway.replay_source import ReplaySource
from pretouch_sensor_gateway.source import DeviceState, SourceStatus

from pretouch.geometry import Pose
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import pose_from_proto, pose_to_proto

MODULES = 6
FRAMES = 120
CALIBRATION = Calibration(
    "", 0.0, tuple(ModuleCalibration(offset=0.001 * k, std=0.0007 + 0.0001 * k) for k in range(MODULES))
)
LOG = structlog.get_logger()


class Port:
    """A `Source` whose batches the test delivers."""

    def __init__(self) -> None:
        self.last = T0

    async def run(self) -> None:
        await asyncio.Event().wait()

    def status(self) -> SourceStatus:
        return SourceStatus(DeviceState.STREAMING)

    def now(self) -> float:
        return self.last

    def calibrate(self, calibration: Calibration | None) -> None:
        """Its batches are what they are."""


@dataclass
class Heard:
    """What a subscriber of StreamRanges and one of StreamPoints were sent."""

    batches: list[bytes] = field(default_factory=list)
    fused: list[FusedSamples] = field(default_factory=list)

    def points(self) -> dict[str, bytes]:
        """Every array of the points, whatever the responses that they came in."""
        columns = {
            name: np.concatenate([getattr(one, name) for one in self.fused])
            for name in ("points", "origins", "directions", "std", "flags")
        }
        for name in ("t", "base_T_tip", "range", "status", "module"):
            columns[name] = np.concatenate([getattr(one.samples, name) for one in self.fused])
        return {name: column.tobytes() for name, column in columns.items()}


def made_batches() -> list[RangeBatch]:
    rng = np.random.default_rng(5)
    batches, k = [], 0
    while k < FRAMES:
        count = int(rng.integers(1, 4))
        ranges = rng.uniform(0.01, 0.09, (count, MODULES))
        status = np.where(rng.random((count, MODULES)) < 0.1, 7, 0).astype(np.uint8)
        ranges[status > 0] = np.nan
        batches.append(
            RangeBatch(
                t=T0 + (k + np.arange(count)) / 30 + rng.normal(0, 1e-4, count),
                time_std=float(rng.uniform(1e-5, 1e-3)),
                sequence=(k + np.arange(count)).astype(np.uint32),
                epoch=0,
                range=ranges,
                raw=ranges + 0.001,
                status=status,
                flags=(rng.random((count, MODULES)) < 0.1).astype(np.uint8),
                lost=int(rng.integers(0, 2)),
                std=np.where(np.isnan(ranges), np.nan, 0.001).astype(np.float32),
            )
        )
        k += count
    return batches


def made_tip(t: float) -> pb.TipPose:
    turn = [np.pi + 0.2 * np.sin(3 * t), 0.1 * np.cos(t), 0.0]
    return pb.TipPose(
        t=T0 + t, base_t_tip=pose_to_proto(Pose.from_rotation_vector(turn, [0.05 * t, 0.01 * np.sin(t), 0.04]))
    )


def new_device(recorder: Any = None) -> Device:
    poses = [pose_from_proto(pose, "") for pose in made_configuration().tip_t_module]
    return Device("left", "/dev/left", poses, CALIBRATION, recorder)


async def stream(device: Device, heard: Heard, requests: AsyncIterator[pb.StreamPointsRequest]) -> None:
    first = await anext(requests)
    with device.subscribe() as subscription:
        async for batch in PointStream(device, subscription, first, requests).fuse(asyncio.Event()):
            heard.fused.append(batch.fused)


async def record(root: Path) -> Heard:
    """Records what a device sends while a robot moves it."""
    heard = Heard()
    sent: asyncio.Queue[list[pb.TipPose] | None] = asyncio.Queue()

    async def requests() -> AsyncIterator[pb.StreamPointsRequest]:
        yield pb.StreamPointsRequest(device="left")
        while (poses := await sent.get()) is not None:
            yield pb.StreamPointsRequest(tip_poses=poses)

    with RecordingWriter(root, LOG) as writer:
        device = new_device(writer.create_recorder("left"))
        device.source = port = Port()
        device.configure(None, None, recording=True)
        calling = asyncio.create_task(stream(device, heard, requests()))
        told = 0
        for batch in made_batches():
            await settled()
            port.last = float(batch.t[-1])
            device.deliver(batch)
            heard.batches.append(batch.message.SerializeToString())
            upto = int((port.last - T0) * 100) + 2
            sent.put_nowait([made_tip(0.01 * k) for k in range(told, upto)])
            told = upto
        await settled()
        port.last += 10.0
        sent.put_nowait(None)
        await calling
    return heard


async def settled() -> None:
    """Lets whatever can run do so."""
    for _ in range(5):
        await asyncio.sleep(0)


async def replay(path: Path, requests: AsyncIterator[pb.StreamPointsRequest]) -> tuple[Heard, Device]:
    """Plays the recording at once."""

    async def no_time(_: float) -> None:
        await asyncio.sleep(0)

    heard = Heard()
    device = Device("left", f"replay:{path}", (Pose.identity(),), None, None)
    device.source = source = ReplaySource(path, device)
    source._player = RecordingPlayer(path, source._play, sleep=no_time)
    with device.subscribe() as subscription:
        calling = asyncio.create_task(stream(device, heard, requests))
        await settled()
        await device.run()
        await calling
        batches, overrun = subscription.take()
    assert overrun == 0
    heard.batches = [batch.message.SerializeToString() for batch in batches]
    return heard, device


async def requests_of(*messages: pb.StreamPointsRequest) -> AsyncIterator[pb.StreamPointsRequest]:
    for message in messages:
        yield message


async def test_a_replay_sends_the_same_batches_and_points_bit_for_bit(tmp_path: Path) -> None:
    live = await record(tmp_path)
    (path,) = files_in(tmp_path)
    again, device = await replay(path, requests_of(pb.StreamPointsRequest(device="left")))
    assert again.batches == live.batches
    assert sum(len(one.samples) for one in live.fused) > 0.9 * FRAMES * MODULES
    assert again.points() == live.points()
    assert [one.unposed for one in again.fused if one.unposed] == [one.unposed for one in live.fused if one.unposed]

    expected = made_configuration()
    assert [pose_to_proto(pose) for pose in device.tip_T_module] == list(expected.tip_t_module)
    assert device.configuration().calibration == calibration_to_proto(CALIBRATION)
    samples = fuse_span(*device.history.between(T0, T0 + 100))
    assert samples.t.tobytes() == live.points()["t"]
    assert samples.base_T_tip.tobytes() == live.points()["base_T_tip"]


async def test_a_client_may_send_a_replayed_device_poses_of_its_own(tmp_path: Path) -> None:
    await record(tmp_path)
    poses = [made_tip(0.01 * k) for k in range(30)]
    again, _ = await replay(files_in(tmp_path)[0], requests_of(pb.StreamPointsRequest(tip_poses=poses)))
    times = np.concatenate([one.samples.t for one in again.fused])
    assert 0 < len(times) < 12 * MODULES
    assert times.max() <= poses[-1].t


async def test_points_and_the_tip_can_be_looked_at_in_base(tmp_path: Path) -> None:
    live = await record(tmp_path)
    messages = recorded_in(files_in(tmp_path)[0])
    clouds = [PointCloud.FromString(one.data) for one in messages if one.topic == "/left/base_points"]
    kinds = np.dtype([("xyz", "<f4", 3), ("std", "<f4"), ("module", "u1"), ("status", "u1"), ("flags", "u1")])
    points = np.concatenate([np.frombuffer(cloud.data, kinds) for cloud in clouds])
    expected = np.concatenate([one.points for one in live.fused])
    expected = expected[np.isfinite(expected[:, 0])]
    np.testing.assert_allclose(points["xyz"], expected, atol=1e-7)
    assert {cloud.frame_id for cloud in clouds} == {"base"}
    assert [field.name for field in clouds[0].fields] == ["x", "y", "z", "std", "module", "status", "flags"]

    transforms = frames_in(one.data for one in messages if one.topic == "/left/tf")
    tips = [one for one in transforms if one.child_frame_id == "left/tip"]
    assert {one.parent_frame_id for one in tips} == {"base"}
    last = tips[-1]
    expected_pose = pose_from_proto(made_tip(last.timestamp.ToNanoseconds() / 1e9 - T0).base_t_tip, "")
    found = [last.translation.x, last.translation.y, last.translation.z]
    np.testing.assert_allclose(found, expected_pose.translation, atol=1e-6)


def frames_in(data: Iterable[bytes]) -> list[Any]:
    return [transform for one in data for transform in FrameTransforms.FromString(one).transforms]
