"""The gateway's times when clocks wrap and jump, and when there is none: over a real port and real calls."""

from __future__ import annotations

import asyncio
import json
import math
import time
from pathlib import Path

import numpy as np
import pytest
from helpers.faulty_board import PAUSE, Board
from helpers.faulty_gateway import Gateway, gateway, unix_offset

from pretouch.geometry import Pose
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import pose_to_proto, samples_from_proto


async def test_times_go_on_when_the_device_clock_and_its_sequence_wrap(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger", first_tick=2**32 - 1_000_000, sequence=2**32 - 200)
    async with gateway(tmp_path / "finger") as clients, clients.listening() as listener:
        await clients.opened()
        await board.bursts(1)
        while board.made <= 200 or board.ticks()[-1] > 2**31:  # both wrap, its clock within a second of its start
            await board.bursts(1)
        await listener.until(lambda: listener.told == board.made)
        status = await clients.status()
    assert board.ticks()[0] > 2**32 - 1_000_000
    assert board.ticks()[-1] < 1_000_000
    assert {2**32 - 1, 0} <= set(listener.sequence())
    assert (listener.got, listener.lost, listener.overrun) == (board.made, 0, 0)
    assert (status.epoch, dict(status.refused)) == (0, {})
    assert (np.diff(list(listener.times().values())) > 0).all()
    listener.check_gaps()
    listener.check_frames({0: 1}, board.times, unix_offset())


async def fused(clients: Gateway, times: list[float]) -> list[float]:
    """Times of the samples of that span, s since the Unix epoch, once a tip that stood still is known there."""
    still = pose_to_proto(Pose.identity())
    start, end = min(times), max(times)
    path = np.linspace(start, end, 2 + math.ceil((end - start) / 0.1))
    points = clients.stub.StreamPoints()
    await points.write(pb.StreamPointsRequest(tip_poses=[pb.TipPose(t=t, base_t_tip=still) for t in path]))
    request = pb.GetSamplesRequest(device="finger", to=end, **{"from": start})
    samples = samples_from_proto((await clients.stub.GetSamples(request)).samples)
    while len(samples) < len(times):
        samples = samples_from_proto((await clients.stub.GetSamples(request)).samples)
    points.cancel()
    return [float(t) for t in samples.t]


async def test_after_the_hosts_clock_jumped_all_times_are_by_the_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    true_time, ahead = time.time, 0.0
    monkeypatch.setattr(time, "time", lambda: true_time() + ahead)
    board = Board(tmp_path / "finger")
    async with gateway(tmp_path / "finger") as clients, clients.listening() as listener:
        await clients.opened()
        for jumps, hour in enumerate((0.0, 3600.0, 0.0, -3600.0)):
            ahead = hour
            before = board.made
            await board.bursts(20)
            await listener.until(lambda: listener.got == board.made)
            status = await clients.status()
            assert status.host_clock_jumps == jumps
            new = {number: t for number, t in listener.times().items() if number >= before}
            assert len(new) == 100
            offset = unix_offset()
            assert max(abs(t - (board.times[1, number] + offset)) for number, t in new.items()) < 1
            assert await fused(clients, list(new.values())) == list(new.values())
    assert (listener.got, listener.lost, listener.overrun) == (board.made, 0, 0) == (400, 0, 0)
    assert (status.epoch, status.connections, status.untimed, dict(status.refused)) == (0, 1, 0, {})
    listener.check_gaps()


async def test_a_device_that_prints_text_is_heard_and_never_spoken_to(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger")
    rng = np.random.default_rng(4)
    printed: list[float] = []
    spoken = rng.integers(20, 60, (101, 3))
    async with gateway(tmp_path / "finger") as clients, clients.listening() as listener:
        await clients.opened()
        for line in spoken.tolist():
            board.write(json.dumps({"mm": line}).encode() + b"\r\n")
            printed.append(time.monotonic())
            await board.written()
            await asyncio.sleep(2 * PAUSE)
        await listener.until(lambda: listener.told == 100)
        status = await clients.until(lambda status: status.rate > 0)
    assert (status.format, len(status.modules)) == ('{{"mm": [{ranges:mm}]}}', 3)
    assert board.asked == b""
    assert (listener.overrun, status.device.lost_frames, status.epoch) == (0, 0, 0)
    assert dict(status.refused) == {"fields": 1}  # the first line may have been the rest of a longer one
    assert listener.lost == status.untimed <= 12  # those by which the format was recognised
    assert listener.sequence() == list(range(listener.got))
    first = 1 + listener.lost
    told = [np.frombuffer(batch.raw.data, "<f8").reshape(-1, 3) for batch in listener.batches]
    np.testing.assert_allclose(np.concatenate(told), spoken[first:] * 1e-3)
    intervals = np.diff(printed)
    std = listener.batches[-1].time_std
    assert 0.9 * np.median(intervals) / math.sqrt(12) < std < 2 * intervals.max()
    spread = 5 * std + np.median(intervals)
    times = np.array(list(listener.times().values())) - unix_offset()
    came = np.repeat(listener.came, [batch.t.shape[0] for batch in listener.batches])
    assert np.median(np.abs(times - printed[first:])) < spread
    assert (times > np.array(printed[first:]) - spread).all()
    assert (times < came + 0.002).all()  # a line that the gateway was late to read is no later than its batch
