"""A recording plays back as it was: bit for bit, at its pace, to its end."""

from __future__ import annotations

import asyncio
import struct
import tempfile
from pathlib import Path

import pytest
from helpers.gateway_recordings import T0, batches_in, files_in, made_batch, made_configuration, measured, series_in
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_sensor_gateway.recording.channels import Channel, Entry
from pretouch_sensor_gateway.recording.file import RecordingFile
from pretouch_sensor_gateway.recording.limits import Limits
from pretouch_sensor_gateway.recording.player import LONGEST_GAP, PlaybackState, Played, RecordingPlayer
from pretouch_sensor_gateway.recording.queue_items import BatchItem, ConfigurationItem, StopItem

from pretouch.v1 import common_pb2
from pretouch.v1 import sensor_gateway_pb2 as pb


def of_bits(bits: int) -> float:
    return float(struct.unpack("<d", bits.to_bytes(8, "little"))[0])


any_double = st.one_of(
    st.floats(),
    st.integers(0, 2**64 - 1).map(of_bits),
    st.integers(1, 2**52 - 1).map(lambda payload: of_bits(0x7FF << 52 | payload)),  # every kind of NaN
)


@st.composite
def fitting_batches(draw: st.DrawFn) -> pb.RangeBatch:
    """Any numbers at all, in arrays that fit each other."""
    frames, modules = draw(st.integers(0, 4)), draw(st.integers(0, 5))

    def array(count: int, width: int, shape: list[int], kind: int) -> common_pb2.Array:
        return common_pb2.Array(
            data=draw(st.binary(min_size=count * width, max_size=count * width)), shape=shape, type=kind
        )

    each, every = frames, frames * modules
    return pb.RangeBatch(
        t=array(each, 8, [frames], common_pb2.SCALAR_TYPE_FLOAT64),
        time_std=draw(any_double),
        sequence=array(each, 4, [frames], common_pb2.SCALAR_TYPE_UINT32),
        epoch=draw(st.integers(0, 2**32 - 1)),
        range=array(every, 8, [frames, modules], common_pb2.SCALAR_TYPE_FLOAT64),
        raw=array(every, 8, [frames, modules], common_pb2.SCALAR_TYPE_FLOAT64),
        status=array(every, 1, [frames, modules], common_pb2.SCALAR_TYPE_UINT8),
        flags=array(every, 1, [frames, modules], common_pb2.SCALAR_TYPE_UINT8),
        lost=draw(st.integers(0, 2**64 - 1)),
    )


any_array = st.builds(
    common_pb2.Array,
    data=st.binary(max_size=40),
    shape=st.lists(st.integers(0, 5), max_size=3),
    type=st.integers(0, 5),
)
malformed_batches = st.builds(
    pb.RangeBatch, t=any_array, time_std=any_double, range=any_array, status=any_array, flags=any_array
)


@settings(max_examples=150, deadline=None)
@given(st.lists(st.one_of(fitting_batches(), malformed_batches), min_size=1, max_size=6))
def test_every_batch_comes_back_bit_for_bit(batches: list[pb.RangeBatch]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = recording_of(Path(folder), batches)
        given_bytes = [batch.SerializeToString() for batch in batches]
        assert batches_in(path) == given_bytes
        _, played = asyncio.run(play(path))
        assert [batch.SerializeToString() for batch in played] == given_bytes


class Watch:
    """A clock that only sleeping moves."""

    def __init__(self) -> None:
        self.now = 5000.0

    def __call__(self) -> float:
        return self.now

    async def sleep(self, seconds: float) -> None:
        self.now += seconds


async def moments(path: Path, busy: float = 0.0) -> list[float]:
    """When each batch is delivered, s since the first; the listener takes `busy` s for each."""
    watch, delivered = Watch(), []

    def deliver(message: Played) -> None:
        if isinstance(message, pb.RangeBatch):
            delivered.append(watch.now)
            watch.now += busy

    await RecordingPlayer(path, deliver, clock=watch, sleep=watch.sleep).run()
    return [moment - delivered[0] for moment in delivered]


class TestPace:
    async def test_it_is_that_of_the_recording(self, tmp_path: Path) -> None:
        path = recording_of(tmp_path, [made_batch(k) for k in (0, 1, 2, 5, 6, 36)])
        expected = [k / 30 for k in (0, 1, 2, 5, 6, 36)]
        assert await moments(path) == pytest.approx(expected, abs=1e-6)

    async def test_a_slow_listener_does_not_stretch_it(self, tmp_path: Path) -> None:
        path = recording_of(tmp_path, [made_batch(k) for k in range(50)])
        assert (await moments(path, busy=0.02))[-1] == pytest.approx(49 / 30, abs=1e-6)

    async def test_nobody_waits_for_an_hour_without_batches(self, tmp_path: Path) -> None:
        path = recording_of(tmp_path, [made_batch(k) for k in (0, 1, 30 * 3000, 30 * 3000 + 1)])
        assert await moments(path) == pytest.approx([0, 1 / 30, 1 / 30 + LONGEST_GAP, 2 / 30 + LONGEST_GAP], abs=1e-6)

    async def test_a_clock_that_steps_back_does_not_stop_it(self, tmp_path: Path) -> None:
        path = recording_of(tmp_path, [made_batch(k) for k in (300, 301, 0, 1)])
        assert await moments(path) == pytest.approx([0, 1 / 30, 1 / 30, 2 / 30], abs=1e-6)


class TestEnds:
    async def test_a_whole_recording(self, tmp_path: Path) -> None:
        path = recording_of(tmp_path, [made_batch(k) for k in range(600)])
        source, played = await play(path)
        assert len(played) == 600
        assert (source.state, source.problem) == (PlaybackState.ENDED, "")

    async def test_configurations_stand_before_the_batches_they_hold_for(self, tmp_path: Path) -> None:
        files = series_in(tmp_path)
        files.write([measured(0), ConfigurationItem(made_configuration(2), T0), measured(1), StopItem()], 0.0)
        seen: list[Played] = []
        await RecordingPlayer(files_in(tmp_path)[0], seen.append, sleep=no_time).run()
        assert seen == [pb.DeviceConfiguration(), made_batch(0), made_configuration(2), made_batch(1)]

    async def test_a_torn_recording_plays_what_is_there_and_says_so(self, tmp_path: Path) -> None:
        path = recording_of(tmp_path, [made_batch(k) for k in range(10)], ended=False)
        whole = path.read_bytes()
        source, played = await play(path)
        assert len(played) == 10
        assert "has no end" in source.problem
        path.write_bytes(whole + whole[-30:-1])
        source, played = await play(path)
        assert len(played) == 10
        assert source.state is PlaybackState.ENDED
        assert "last 29 bytes" in source.problem

    async def test_files_that_cannot_be_played(self, tmp_path: Path) -> None:
        for content, text in ((None, "No such file"), (b"t,range\n", "no MCAP file"), (b"", "no batch of ranges")):
            path = tmp_path / "x.mcap"
            if content is not None:
                path.write_bytes(content)
            source, played = await play(path)
            assert played == []
            assert source.state is PlaybackState.FAILED
            assert text in source.problem

    async def test_a_damaged_batch_is_left_out_and_counted(self, tmp_path: Path) -> None:
        file = RecordingFile(tmp_path / "x.mcap", "left")
        contents = [made_batch(0).SerializeToString(), b"\xff" * 9, made_batch(2).SerializeToString()]
        for k, content in enumerate(contents):
            file.add(Entry(Channel.RANGES, k, content))
        file.finish()
        source, played = await play(file.path)
        assert [batch.SerializeToString() for batch in played] == contents[::2]
        assert "1 of its messages" in source.problem

    async def test_it_can_be_cancelled_anywhere(self, tmp_path: Path) -> None:
        path = recording_of(tmp_path, [made_batch(k) for k in range(3)])
        played: list[pb.RangeBatch] = []

        async def forever(_: float) -> None:
            await asyncio.Event().wait()

        task = asyncio.create_task(RecordingPlayer(path, played.append, sleep=forever).run())
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert played == []


def recording_of(root: Path, batches: list[pb.RangeBatch], ended: bool = True) -> Path:
    files = series_in(root, Limits(file_seconds=1e12))
    files.write(
        [ConfigurationItem(made_configuration(), T0), *(BatchItem(batch, len(batch.t.data) // 8) for batch in batches)],
        0,
    )
    if ended:
        files.write([StopItem()], 0.0)
    return files_in(root)[0]


async def play(path: Path) -> tuple[RecordingPlayer, list[pb.RangeBatch]]:
    """The player after it has played all, and the batches that it played."""
    played: list[Played] = []
    player = RecordingPlayer(path, played.append, sleep=no_time)
    await player.run()
    return player, [message for message in played if isinstance(message, pb.RangeBatch)]


async def no_time(_: float) -> None:
    """Waits for nothing."""
