"""Whole and torn recordings are read to their last whole record, and other files are refused in words."""

from __future__ import annotations

import os
from io import BytesIO
from pathlib import Path

import pytest
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet
from helpers.gateway_recordings import (
    RANGES,
    T0,
    batches_in,
    files_in,
    made_batch,
    made_configuration,
    measured,
    series_in,
)
from hypothesis import given
from hypothesis import strategies as st
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from pretouch_sensor_gateway.recording.channels import Channel, schema_of
from pretouch_sensor_gateway.recording.queue_items import ConfigurationItem, EventItem, StopItem
from pretouch_sensor_gateway.recording.validation import check_recording

from pretouch.errors import InvalidInput
from pretouch.recording.reader import RecordingReader


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished recording of three batches, a configuration and an event."""
    root = tmp_path_factory.mktemp("whole")
    files = series_in(root)
    files.write([ConfigurationItem(made_configuration(), 0.0)], 0.0)
    files.write([measured(0), EventItem("lost", 1_780_000_000.0), measured(1, 4), measured(5)], 0.0)
    files.write([StopItem()], 0.0)
    return files_in(root)[0]


def message_ends(path: Path) -> list[int]:
    """Where in the file each message ends, as MCAP's own reader finds it."""
    ends = []
    with path.open("rb") as stream:
        for record in StreamReader(stream).records:
            if type(record).__name__ == "Message":
                ends.append(stream.tell())
    return ends


class TestTornFiles:
    def test_whatever_is_whole_is_read_wherever_the_file_ends(self, whole: Path, tmp_path: Path) -> None:
        content, ends = whole.read_bytes(), message_ends(whole)
        messages = list(RecordingReader(whole))
        assert len(messages) == len(ends) == 10  # 3 x ranges and points, configuration, transforms, 2 x log
        torn = tmp_path / "torn.mcap"
        torn.write_bytes(content)
        for length in reversed(range(len(content))):
            os.truncate(torn, length)
            reader = RecordingReader(torn)
            assert list(reader) == messages[: sum(end <= length for end in ends)]
            assert not reader.complete
            assert 0 <= reader.torn_bytes <= length
            if length in ends:
                assert reader.torn_bytes == 0
            if length - 1 in ends:
                assert reader.torn_bytes == 1

    def test_a_whole_file_is_complete(self, whole: Path) -> None:
        reader = RecordingReader(whole)
        assert len(list(reader)) == 10
        assert (reader.complete, reader.torn_bytes) == (True, 0)
        assert len(list(reader)) == 10  # again

    def test_a_file_is_read_while_it_is_written(self, tmp_path: Path) -> None:
        files = series_in(tmp_path)
        for k in range(3):
            files.write([measured(k)], 0.0)
            assert len(batches_in(files_in(tmp_path)[0])) == k + 1
        files.write([StopItem()], 0.0)

    def test_zeros_that_a_lost_power_supply_leaves_are_torn(self, whole: Path, tmp_path: Path) -> None:
        end = message_ends(whole)[-1]
        torn = tmp_path / "torn.mcap"
        torn.write_bytes(whole.read_bytes()[:end] + bytes(5000))
        reader = RecordingReader(torn)
        assert len(list(reader)) == 10
        assert (reader.complete, reader.torn_bytes) == (False, 5000)

    @given(st.binary(max_size=200), st.integers(0, 20_000))
    def test_garbage_never_raises(self, whole: Path, garbage: bytes, offset: int) -> None:
        content = bytearray(whole.read_bytes())
        content[8 + offset : 8 + offset + len(garbage)] = garbage
        damaged = whole.with_name("damaged")
        damaged.write_bytes(content)
        reader = RecordingReader(damaged)
        list(reader)
        assert 0 <= reader.torn_bytes <= len(content)


@pytest.mark.parametrize("compression", list(CompressionType))
def test_files_that_other_tools_have_chunked_are_read(tmp_path: Path, compression: CompressionType) -> None:
    path = tmp_path / "recovered.mcap"
    batches = [made_batch(k).SerializeToString() for k in range(50)]
    path.write_bytes(written(batches, schema_of(Channel.RANGES), chunk_size=2000, compression=compression))
    assert batches_in(path) == batches
    check_recording(path)


class TestCheck:
    def test_a_recording_gives_its_configuration(self, whole: Path) -> None:
        assert check_recording(whole) == (made_configuration(), T0)

    def test_a_torn_recording_will_do_as_long_as_a_batch_is_whole(self, whole: Path, tmp_path: Path) -> None:
        torn = tmp_path / "torn.mcap"
        first_batch = message_ends(whole)[3]  # after configuration, transforms, log
        torn.write_bytes(whole.read_bytes()[:first_batch])
        check_recording(torn)
        torn.write_bytes(whole.read_bytes()[: first_batch - 1])
        assert_refused(torn, "cut off before its first batch")

    def test_other_files(self, tmp_path: Path) -> None:
        path = tmp_path / "x.mcap"
        assert_refused(path, "There is no file")
        path.write_text("t,range\n0,1\n")
        assert_refused(path, "no MCAP file")
        path.write_bytes(b"")
        assert_refused(path, "cut off before its first batch")
        path.write_bytes(written([b""], schema_of(Channel.LOG), name="foxglove.Log"))
        assert_refused(path, "holds no ranges")
        path.write_bytes(written([b""], b"no descriptors"))
        assert_refused(path, "damaged")
        assert_refused(tmp_path, "is a folder")

    def test_a_field_that_is_not_known_is_named(self, tmp_path: Path) -> None:
        path = tmp_path / "x.mcap"
        for message, field in (("RangeBatch", "ambient"), ("Array", "unit")):
            path.write_bytes(written([b""], with_field(message, field)))
            assert_refused(path, f"pretouch.v1.{message}.{field}")

    def test_what_else_the_newer_file_describes_does_not_matter(self, tmp_path: Path) -> None:
        path = tmp_path / "x.mcap"
        path.write_bytes(written([b""], with_field("Device", "colour")))
        check_recording(path)


def written(
    data: list[bytes],
    schema: bytes,
    name: str = RANGES,
    chunk_size: int = 10**6,
    compression: CompressionType = CompressionType.ZSTD,
) -> bytes:
    """A chunked file of one channel, by MCAP's own writer."""
    stream = BytesIO()
    writer = Writer(stream, chunk_size=chunk_size, compression=compression)
    writer.start()
    channel = writer.register_channel("/left/ranges", "protobuf", writer.register_schema(name, "protobuf", schema))
    for k, content in enumerate(data):
        writer.add_message(channel, k, content, k)
    writer.finish()
    return stream.getvalue()


def with_field(message: str, field: str) -> bytes:
    """The schema of ranges, had a later version added `field` to `message`."""
    described = FileDescriptorSet.FromString(schema_of(Channel.RANGES))
    (found,) = (found for file in described.file for found in file.message_type if found.name == message)
    found.field.add(name=field, number=99, type=FieldDescriptorProto.TYPE_DOUBLE)
    return described.SerializeToString()


def assert_refused(path: Path, text: str) -> None:
    with pytest.raises(InvalidInput) as refusal:
        check_recording(path)
    assert text in refusal.value.detail
    assert refusal.value.remedy
