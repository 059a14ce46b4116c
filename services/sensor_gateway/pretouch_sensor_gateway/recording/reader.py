"""Reads recordings: whole ones, and ones truncated because their writer was killed or the disk was full."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mcap.exceptions import InvalidMagic
from mcap.records import Channel, Footer, Message, Schema
from mcap.stream_reader import MAGIC_SIZE, StreamReader

from pretouch.errors import InvalidInput


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

    The iteration ends at the first record or chunk that cannot be read; `torn_bytes` counts the rest of the file.

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

    def __iter__(self) -> Iterator[Recorded]:
        self.complete = False
        with self._path.open("rb") as stream:
            size = self.torn_bytes = os.fstat(stream.fileno()).st_size
            records = StreamReader(stream, validate_crcs=True, record_size_limit=size).records
            while True:
                try:
                    record = next(records, None)
                except InvalidMagic as error:
                    if stream.tell() > MAGIC_SIZE:
                        return
                    raise InvalidInput(f"{self._path} is no MCAP file.", "Give a recording of the gateway.") from error
                except OSError:
                    raise
                except Exception:  # every decoder and decompressor has its own for bytes that it cannot read
                    return
                match record:
                    case None:
                        self.complete, self.torn_bytes = True, size - stream.tell()
                        return
                    case Schema():
                        self._schemas[record.id] = record
                    case Channel():
                        self._channels[record.id] = record
                    case Message():
                        yield self._recorded(record)
                    case Footer():
                        continue  # whole only with the magic that follows
                self.torn_bytes = size - stream.tell()

    def _recorded(self, message: Message) -> Recorded:
        channel = self._channels[message.channel_id]
        schema = self._schemas.get(channel.schema_id)
        name, described = (schema.name, schema.data) if schema else ("", b"")
        return Recorded(channel.topic, name, described, message.log_time, message.data)
