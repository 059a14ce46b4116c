"""The gateway as a process that records: killed, told to end under load, and starved of disk."""

from __future__ import annotations

import asyncio
import resource
import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import grpc
from helpers.faulty_board import Board
from helpers.faulty_gateway import TIMEOUT, Gateway, client, small_window
from helpers.gateway_recordings import files_in, sequence_in
from helpers.processes import Service, free_port
from pretouch_sensor_gateway.configuration import VARIABLE

from pretouch.recording.reader import RecordingReader
from pretouch.v1 import sensor_gateway_pb2 as pb

GRACE = 1.0


def recording_gateway(folder: Path) -> Service:
    """A process that records the device `finger` on the port of that name; not started."""
    (folder / "gateway.toml").write_text(
        f'recordings = "recordings"\n[devices.finger]\naddress = "{folder / "finger"}"\nrecord = true\n'
    )
    return Service("gateway", free_port(), {VARIABLE: str(folder / "gateway.toml"), "PRETOUCH_GRACE": str(GRACE)})


@asynccontextmanager
async def running(service: Service) -> AsyncIterator[Gateway]:
    """A client of the process, which is killed in the end if it has not ended by itself."""
    async with asyncio.timeout(TIMEOUT):
        await asyncio.to_thread(service.start)
        try:
            async with client(service.port) as clients:
                yield clients
        finally:
            await asyncio.to_thread(service.kill)


def recordings(folder: Path) -> list[Path]:
    return files_in(folder / "recordings", "finger")


def read(path: Path) -> RecordingReader:
    """A reader that has read all."""
    reader = RecordingReader(path)
    assert list(reader)
    return reader


async def test_kill_9_leaves_a_readable_recording_and_the_next_start_goes_on_in_another(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger", modules=6)
    service = recording_gateway(tmp_path)
    async with running(service) as clients, clients.listening() as listener:
        await clients.opened()
        measuring = asyncio.create_task(board.measure_on())
        await clients.until(lambda status: status.recording.frames > 0)
        recorded = (await clients.status()).recording.frames
        await listener.until(lambda: listener.got >= recorded + 300)
        assert await asyncio.to_thread(service.kill) == -signal.SIGKILL
        assert (await listener.ended()).code() is grpc.StatusCode.UNAVAILABLE
        measuring.cancel()
    (first,) = recordings(tmp_path)
    assert not read(first).complete
    found = sequence_in(first)
    assert found == list(range(len(found)))
    assert len(found) >= recorded > 0  # what the status counts is in the file

    async with running(service) as clients, clients.listening() as listener:
        await clients.opened()
        await board.bursts(40)
        await listener.until(lambda: listener.got >= 150)
        await clients.until(lambda status: status.recording.frames == status.device.frames)
        assert await asyncio.to_thread(service.stop) == 0
    listener.check_gaps()
    assert recordings(tmp_path)[0] == first
    _, second = recordings(tmp_path)
    assert read(second).complete
    assert set(listener.sequence()) <= set(sequence_in(second))
    assert sequence_in(first) == found  # untouched
    assert min(sequence_in(second)) > found[-1]


async def test_sigterm_under_load_ends_streams_and_recording_in_order(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger", modules=64)
    service = recording_gateway(tmp_path)
    async with (
        running(service) as clients,
        clients.listening() as one,
        clients.listening() as two,
        small_window(clients.port) as idle,
        idle.listening() as stuck,
    ):
        stuck.reads.clear()
        await clients.opened()
        measuring = asyncio.create_task(board.measure_on(frames=10))
        await one.until(lambda: one.got >= 500)
        await clients.until(lambda status: status.overrun > 0)
        assert await asyncio.to_thread(service.stop) == 0
        measuring.cancel()
        stuck.reads.set()
        for listener in (one, two, stuck):
            assert (await listener.ended()).code() is grpc.StatusCode.UNAVAILABLE
    for reader in (one, two):
        assert reader.end is not None
        assert reader.end.details() == "The gateway is shutting down."  # of itself, not cut off after its grace
        assert (reader.lost, reader.overrun) == (0, 0)
        assert reader.sequence() == list(range(reader.got))
    stuck.check_gaps()
    found = []
    for path in recordings(tmp_path):
        reader_of = read(path)
        assert (reader_of.complete, reader_of.torn_bytes) == (True, 0)
        found += sequence_in(path)
    too_slow = sum(line["frames"] for line in service.log if line["event"] == "the disk is too slow to record all")
    assert found == sorted(set(found))
    assert found[-1] + 1 == len(found) + too_slow
    assert found[-1] + 1 >= max(one.got, two.got)


async def test_a_full_disk_disturbs_no_stream_and_says_what_it_cost(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger", modules=6)
    service = recording_gateway(tmp_path)
    async with running(service) as clients, clients.listening() as listener:
        await clients.opened()
        pid = service.logged("ready")["pid"]
        await board.bursts(20)
        before = await clients.until(lambda status: status.recording.frames == 100)
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (before.recording.bytes + 50_000, resource.RLIM_INFINITY))
        problem = ""
        while not problem:
            await board.bursts(10)
            problem = (await clients.status()).recording.problem
        assert "File too large" in problem
        await board.bursts(10)
        full = await clients.until(lambda status: not status.recording.pending)
        assert full.recording.frames + full.recording.unrecorded == full.device.frames == board.made
        assert full.recording.unrecorded >= 50
        assert full.device.state == pb.DEVICE_STATE_STREAMING
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        for on in (False, True):  # else it would be tried again only after some seconds
            await clients.stub.Configure(pb.ConfigureRequest(recording=on))
        await board.bursts(20)
        again = await clients.until(lambda status: status.recording.frames == full.recording.frames + 100)
        assert again.recording.problem == ""
        assert again.recording.unrecorded == full.recording.unrecorded
        await listener.until(lambda: listener.got == board.made)
        assert await asyncio.to_thread(service.stop) == 0
    assert (listener.lost, listener.overrun) == (0, 0)
    first, second = recordings(tmp_path)
    assert sequence_in(second) == list(range(board.made - 100, board.made))
    found = sequence_in(first)
    assert found == list(range(full.recording.frames))
    assert read(first).torn_bytes == 0
    assert read(second).complete
    assert [line["event"] for line in service.log].count("recording is paused") == 1
