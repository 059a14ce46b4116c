"""Files that are no recordings, or that unpack to more than any recording: refused, with bounded work."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet
from helpers.session_recordings import recorded_session
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk
from mcap.writer import Writer
from pretouch_orchestrator.recording.file import write_recording

from pretouch.errors import InvalidInput, TooLarge
from pretouch.recording import reader
from pretouch.recording.reader import Recorded, RecordingReader
from pretouch.recording.schema import describe_schema
from pretouch.recording.session_file import read_session_recording
from pretouch.recording.writer import write_messages
from pretouch.v1.session_recording_pb2 import RecordedScan, RecordedSession

ZEROS = bytes(64 * 2**20)


@pytest.fixture(scope="module")
def recording() -> bytes:
    return write_recording(*recorded_session())


@pytest.fixture
def placed(tmp_path: Path) -> Callable[[bytes], Path]:
    """A file with these bytes."""

    def place(content: bytes) -> Path:
        path = tmp_path / "session.mcap"
        path.write_bytes(content)
        return path

    return place


def messages(file: bytes, path: Path) -> list[Recorded]:
    path.write_bytes(file)
    return list(RecordingReader(path))


def test_a_recording_is_read_whole(recording: bytes, placed: Callable[[bytes], Path]) -> None:
    read = read_session_recording(placed(recording))
    assert read.complete
    assert [scan.number for scan in read.scans] == [1, 2, 3]


def test_of_a_truncated_recording_what_is_there_is_read(recording: bytes, tmp_path: Path) -> None:
    every = messages(recording, tmp_path / "whole.mcap")
    after = [each.topic for each in every].index("/pretouch/scans") + 1
    path = tmp_path / "cut.mcap"
    path.write_bytes(write_messages(every[:after])[:-30])
    read = read_session_recording(path)
    assert not read.complete
    assert [scan.number for scan in read.scans] == [1]


@pytest.mark.parametrize("kept", [0, 7, 20, 2000])
def test_too_little_of_a_recording_is_refused(recording: bytes, placed: Callable[[bytes], Path], kept: int) -> None:
    with pytest.raises(InvalidInput, match=r"no recording of a session.*cut off|no MCAP file"):
        read_session_recording(placed(recording[:kept]))


def test_other_files_are_refused(placed: Callable[[bytes], Path], tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="no MCAP file"):
        read_session_recording(placed(b"solid cube\nfacet normal 0 0 1\n" * 10))
    foreign = write_messages([Recorded("/chatter", "std_msgs.String", b"", 0, b"hello")])
    with pytest.raises(InvalidInput, match=r"no recording of a session"):
        read_session_recording(placed(foreign))
    for path in (tmp_path, tmp_path / "nothing.mcap"):
        with pytest.raises(InvalidInput, match="cannot be read"):
            read_session_recording(path)


def test_garbage_in_its_message_is_refused(placed: Callable[[bytes], Path]) -> None:
    for described in (describe_schema(RecordedSession), b"\xff"):
        message = Recorded("/pretouch/session", "pretouch.v1.RecordedSession", described, 0, b"\xff\xff\xff")
        with pytest.raises(InvalidInput, match="damaged"):
            read_session_recording(placed(write_messages([message])))


def test_a_newer_versions_field_is_named(recording: bytes, placed: Callable[[bytes], Path], tmp_path: Path) -> None:
    described = FileDescriptorSet.FromString(describe_schema(RecordedScan))
    (file,) = (each for each in described.file if each.name.endswith("session_recording.proto"))
    (kind,) = (each for each in file.message_type if each.name == "RecordedScan")
    kind.field.add(name="colour", number=99, type=FieldDescriptorProto.TYPE_DOUBLE)
    newer = [
        Recorded(each.topic, each.schema, described.SerializeToString(), each.time, each.data)
        if each.schema == "pretouch.v1.RecordedScan"
        else each
        for each in messages(recording, tmp_path / "old.mcap")
    ]
    with pytest.raises(InvalidInput, match=r"another version.*RecordedScan\.colour"):
        read_session_recording(placed(write_messages(newer)))


def test_a_missing_scan_is_noticed(recording: bytes, placed: Callable[[bytes], Path], tmp_path: Path) -> None:
    every = messages(recording, tmp_path / "whole.mcap")
    first = next(each for each in every if each.topic == "/pretouch/scans")
    with pytest.raises(InvalidInput, match="scan number 1 is missing"):
        read_session_recording(placed(write_messages(each for each in every if each is not first)))


def file_with(chunks: Sequence[Chunk]) -> bytes:
    """Magic, header, and these chunks."""
    out = io.BytesIO()
    writer = Writer(out)
    writer.start()
    beginning = out.getvalue()
    builder = RecordBuilder()
    for chunk in chunks:
        chunk.write(builder)
    return beginning + builder.end()


def chunk_of(data: bytes, compression: str, claimed: int) -> Chunk:
    return Chunk(
        compression=compression,
        data=data,
        message_start_time=0,
        message_end_time=0,
        uncompressed_crc=0,
        uncompressed_size=claimed,
    )


@pytest.mark.parametrize("kind", ["zstd", "lz4"])
@pytest.mark.parametrize("claimed", [10, len(ZEROS)])
def test_a_chunk_that_unpacks_to_too_much_is_not_unpacked(
    kind: str, claimed: int, placed: Callable[[bytes], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reader, "MAX_CHUNK", 2**20)
    packed = zstandard.compress(ZEROS) if kind == "zstd" else lz4.frame.compress(ZEROS)
    lengths = []
    unpack = reader._decompress
    monkeypatch.setattr(reader, "_decompress", lambda chunk: lengths.append(len(data := unpack(chunk))) or data)
    path = placed(file_with([chunk_of(packed, kind, claimed)]))
    read = RecordingReader(path)
    assert list(read) == []
    assert not read.complete
    assert all(length <= claimed + 1 for length in lengths)
    assert len(lengths) == (claimed == 10), "what claims too much is not even begun"


def test_many_chunks_of_nothing_end_the_reading(placed: Callable[[bytes], Path]) -> None:
    unknown = b"\x80" + (2**20 - 9).to_bytes(8, "little") + bytes(2**20 - 9)  # a record that readers pass over
    packed = zstandard.compress(unknown)
    chunks = [chunk_of(packed, "zstd", 2**20)] * 20
    with pytest.raises(TooLarge, match=re.escape("holds too much")):
        list(RecordingReader(placed(file_with(chunks)), most=4 * 2**20))
