"""One MCAP file being written.

Every commit ends a compressed chunk and is one write to the operating system: however the process ends, everything
committed is in the file, and readers of truncated files recover it. Only `finish` adds the summary and footer.
"""

from __future__ import annotations

import errno
import io
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from google.protobuf.message import Message
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from pretouch_sensor_gateway.recording.channels import Channel, Entry, schema_of

_RECORD_BYTES = 48
"""More than MCAP adds to a message: its head (31 bytes), and its place in the index (16)."""
_CHUNK_BYTES = 512
"""More than MCAP adds to a chunk: its head and its indexes' heads, and its entry in the summary."""
_DEFAULT_CHUNK = 2**20
"""Bytes after which MCAP's writer ends a chunk by itself."""
_SCHEMA_BYTES = sum(len(schema_of(channel)) for channel in Channel) + 2048
"""More than schemas, channels, statistics and footer take."""


class RecordingFile:
    """A new file at `path`, for the channels of `device`.

    After an error of `commit` or `finish` only `abandon` may be called.

    Attributes:
        path: where it is.
        size: bytes committed.

    Raises:
        OSError: it cannot be created, or is there already.
    """

    def __init__(self, path: Path, device: str) -> None:
        self.path = path
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self._buffer = _Buffer()
        self._writer = Writer(self._buffer, enable_data_crcs=True)
        self._writer.start(library="pretouch")
        self._device = device
        self._channels: dict[Channel, int] = {}
        self._schemas: dict[type[Message], int] = {}
        self._sequence = dict.fromkeys(Channel, 0)
        self._chunks = 0
        self._added = _SCHEMA_BYTES  # bytes at most of the next commit

    @property
    def size(self) -> int:
        return self._buffer.start

    def size_with(self, entries: Sequence[Entry]) -> int:
        """Bytes at most of the file if it ended after `entries`."""
        more = sum(_size_at_most(entry) for entry in entries)
        chunks = self._chunks + 1 + (self._added + more) // _DEFAULT_CHUNK
        return self.size + self._added + more + chunks * _CHUNK_BYTES + _SCHEMA_BYTES

    def add(self, entry: Entry) -> None:
        """Adds `entry` to the next commit."""
        channel, sequence = self._register(entry.channel), self._sequence[entry.channel]
        self._writer.add_message(channel, entry.time, entry.data, entry.time, sequence)
        self._sequence[entry.channel] += 1
        self._added += _size_at_most(entry)

    def commit(self) -> None:
        """Writes all added entries.

        Raises:
            OSError: not all could be written; the file is truncated to where it ended before.
        """
        if not self._added:
            return
        self._chunks += 1 + self._added // _DEFAULT_CHUNK
        self._added = 0
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._write()

    def finish(self) -> None:
        """Adds summary and footer, and closes the file.

        Raises:
            OSError: likewise; what was committed before is in the file.
        """
        self.commit()
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._write()
        descriptor, self._descriptor = self._descriptor, -1
        os.close(descriptor)

    def abandon(self) -> None:
        """Closes the file as it is, and deletes it if nothing was committed."""
        with suppress(OSError):
            os.close(self._descriptor)
        if not self.size:
            with suppress(OSError):
                self.path.unlink()

    def _write(self) -> None:
        data = self._buffer.getvalue()
        try:
            if os.fstat(self._descriptor).st_nlink == 0:
                raise OSError(errno.ENOENT, "The file was deleted while it was written")
            remaining = memoryview(data)
            while remaining:
                remaining = remaining[os.write(self._descriptor, remaining) :]
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._descriptor, self.size)
            raise
        self._buffer.drop_committed(len(data))

    def _register(self, channel: Channel) -> int:
        """The number of the channel, which is registered with its first message."""
        message = channel.message
        if message not in self._schemas:
            name, schema = message.DESCRIPTOR.full_name, schema_of(channel)
            self._schemas[message] = self._writer.register_schema(name, SchemaEncoding.Protobuf, schema)
        if channel not in self._channels:
            topic = channel.topic(self._device)
            self._channels[channel] = self._writer.register_channel(
                topic, MessageEncoding.Protobuf, self._schemas[message]
            )
        return self._channels[channel]


def _size_at_most(entry: Entry) -> int:
    return len(entry.data) + len(entry.data) // 256 + _RECORD_BYTES


class _Buffer(io.BytesIO):
    """Holds what is not yet committed; positions count from the start of the file, as the writer expects.

    Attributes:
        start: bytes committed.
    """

    def __init__(self) -> None:
        super().__init__()
        self.start = 0

    def tell(self) -> int:
        return self.start + super().tell()

    def drop_committed(self, count: int) -> None:
        self.start += count
        self.seek(0)
        self.truncate()
