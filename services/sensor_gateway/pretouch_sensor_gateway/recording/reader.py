"""Reads recordings: whole ones, and ones truncated because their writer was killed or the disk was full."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC

from pretouch.errors import InvalidInput

_HEAD = struct.Struct("<BQ")  # of a record: opcode, length
_READ = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK}


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

    The iteration ends at the first record that cannot be read; `torn_bytes` counts the rest of the file.

    Attributes:
        complete: whether the file was finished; known at the end of the iteration.
        torn_bytes: bytes at the end that are no whole record; known then, too.

    Raises:
        OSError: on iteration, the file cannot be read.
        InvalidInput: on iteration, the file is no MCAP file.
    """

    def __init__(self, path: Path) -> None:
        self.complete = False
        self.torn_bytes = 0
        self._path = path
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}

    def schemas(self) -> set[str]:
        """Names of the schemas found so far."""
        return {schema.name for schema in self._schemas.values()}

    def __iter__(self) -> Iterator[Recorded]:
        self.complete = False
        with self._path.open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            magic = stream.read(len(MCAP0_MAGIC))
            if not MCAP0_MAGIC.startswith(magic):
                raise InvalidInput(f"{self._path} is no MCAP file.", "Give a recording of the gateway.")
            whole = len(magic) if magic == MCAP0_MAGIC else 0
            while not self.complete:
                head = stream.read(_HEAD.size)
                if len(head) < _HEAD.size:
                    break
                opcode, length = _HEAD.unpack(head)
                if opcode == 0 or length > size - whole - _HEAD.size:  # a lost power supply may leave zeros
                    break
                if opcode in _READ:
                    try:
                        messages = self._read(opcode, stream.read(length))
                    except Exception:  # every decoder and decompressor has its own for bytes that it cannot read
                        break
                    yield from messages
                else:
                    stream.seek(length, os.SEEK_CUR)
                whole += _HEAD.size + length
                if opcode == Opcode.FOOTER and stream.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC:
                    whole += len(MCAP0_MAGIC)
                    self.complete = True
            self.torn_bytes = size - whole

    def _read(self, opcode: int, content: bytes) -> list[Recorded]:
        stream = ReadDataStream(BytesIO(content))
        match opcode:
            case Opcode.SCHEMA:
                return self._note(Schema.read(stream))
            case Opcode.CHANNEL:
                return self._note(Channel.read(stream))
            case Opcode.MESSAGE:
                return self._note(Message.read(stream, len(content)))
            case _:
                records = breakup_chunk(Chunk.read(stream), validate_crc=True)
                return [message for record in records for message in self._note(record)]

    def _note(self, record: Any) -> list[Recorded]:
        match record:
            case Schema():
                self._schemas[record.id] = record
            case Channel():
                self._channels[record.id] = record
            case Message():
                channel = self._channels[record.channel_id]
                schema = self._schemas.get(channel.schema_id)
                name, described = (schema.name, schema.data) if schema else ("", b"")
                return [Recorded(channel.topic, name, described, record.log_time, record.data)]
        return []
