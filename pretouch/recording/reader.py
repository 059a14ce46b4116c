"""Reads recordings: whole ones, and ones truncated because their writer was killed or the disk was full."""

from __future__ import annotations

import math
import os
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import InvalidMagic
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Footer, McapRecord, Message, Schema
from mcap.stream_reader import MAGIC_SIZE, StreamReader

from pretouch.errors import InvalidInput, TooLarge

MAX_CHUNK = 128 * 2**20
"""Bytes of a chunk when it is unpacked. Writers end a chunk at about 1 MiB, and the longest message has 40 MiB."""


@dataclass(frozen=True)
class Recorded:
    """One message of a recording.

    Attributes:
        topic: of its channel.
        schema: name of its channel's schema, "" if it has none.
        described: that schema itself.
        time: Unix time, ns.
        data: the message, serialised.
    """

    topic: str
    schema: str
    described: bytes
    time: int
    data: bytes


class RecordingReader:
    """Iterates over the messages of an MCAP file, chunked or not, in the order of the file.

    The iteration ends at the first record or chunk that cannot be read; `torn_bytes` counts the rest of the file. No
    more than a chunk is held, and none that claims to be, or is, larger than MAX_CHUNK.

    Args:
        most: bytes that all chunks together may have when they are unpacked; None: any number.

    Attributes:
        complete: whether the file was finished; known at the end of the iteration.
        torn_bytes: bytes at the end that are no whole record; known then, too.

    Raises:
        OSError: on iteration, the file cannot be read.
        InvalidInput: on iteration, the file is no MCAP file.
        TooLarge: on iteration, its chunks have more than `most` bytes.
    """

    def __init__(self, path: Path, most: int | None = None) -> None:
        self.complete = False
        self.torn_bytes = 0
        self._path = path
        self._left = math.inf if most is None else most
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}

    def __iter__(self) -> Iterator[Recorded]:
        self.complete = False
        with self._path.open("rb") as stream:
            size = self.torn_bytes = os.fstat(stream.fileno()).st_size
            reader = StreamReader(stream, emit_chunks=True, validate_crcs=True, record_size_limit=min(size, MAX_CHUNK))
            records = reader.records
            while True:
                try:
                    record = next(records, None)
                    if isinstance(record, Chunk):
                        self._spend(record.uncompressed_size)
                    inside = _unpack(record) if isinstance(record, Chunk) else [record] if record else []
                    for each in inside:
                        match each:
                            case Schema():
                                self._schemas[each.id] = each
                            case Channel():
                                self._channels[each.id] = each
                            case Message():
                                yield self._recorded(each)
                except InvalidMagic as error:
                    if stream.tell() > MAGIC_SIZE:
                        return
                    raise InvalidInput(f"{self._path} is no MCAP file.", "Give a recording of pretouch.") from error
                except (OSError, TooLarge):
                    raise
                except Exception:  # every decoder and decompressor has its own for bytes that it cannot read
                    return
                if record is None:
                    self.complete, self.torn_bytes = True, size - stream.tell()
                    return
                if not isinstance(record, Footer):  # whole only with the magic that follows
                    self.torn_bytes = size - stream.tell()

    def _spend(self, size: int) -> None:
        self._left -= size
        if self._left < 0:
            raise TooLarge(
                f"{self._path} holds too much: it is no recording of one session, or damaged.", "Give another file."
            )

    def _recorded(self, message: Message) -> Recorded:
        channel = self._channels[message.channel_id]
        schema = self._schemas.get(channel.schema_id)
        name, described = (schema.name, schema.data) if schema else ("", b"")
        return Recorded(channel.topic, name, described, message.log_time, message.data)


def _unpack(chunk: Chunk) -> Iterator[McapRecord]:
    """The records of a chunk, one by one; raises some error where it is damaged or too large."""
    data = _decompress(chunk)
    if len(data) != chunk.uncompressed_size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
        raise ValueError("the chunk is damaged")
    stream = ReadDataStream(BytesIO(data))
    while stream.count < len(data):
        opcode, length = stream.read1(), stream.read8()
        if opcode == Opcode.SCHEMA:
            yield Schema.read(stream)
        elif opcode == Opcode.CHANNEL:
            yield Channel.read(stream)
        elif opcode == Opcode.MESSAGE:
            yield Message.read(stream, length)
        else:
            stream.read(length)


def _decompress(chunk: Chunk) -> bytes:
    """At most the size that the chunk claims, and a byte more where it claims too little."""
    if chunk.uncompressed_size > MAX_CHUNK:
        raise ValueError("the chunk is too large")
    match chunk.compression:
        case "zstd":
            with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
                return bytes(reader.read(chunk.uncompressed_size + 1))
        case "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, chunk.uncompressed_size + 1))
        case _:
            return bytes(chunk.data)
