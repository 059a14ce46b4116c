"""One MCAP file being written.

The file is not chunked, and every commit is one write to the operating system: however the process ends, everything
committed is in the file, and readers of truncated files recover it. Only `finish` adds the summary and footer.
"""

from __future__ import annotations

import errno
import io
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from pretouch_sensor_gateway.recording.channels import Channel, Entry, schema_of

_RECORD_BYTES = 31
"""What MCAP adds to a message: opcode, length, channel, sequence and two times."""
_END_BYTES = sum(len(schema_of(channel)) for channel in Channel) + 2048
"""More than the end of a file takes: schemas again, channels, statistics, footer."""


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
        self._writer = Writer(self._buffer, use_chunking=False, enable_data_crcs=True)
        self._writer.start(library="pretouch")
        self._channels = {channel: self._register(channel, device) for channel in Channel}
        self._sequence = dict.fromkeys(Channel, 0)

    @property
    def size(self) -> int:
        return self._buffer.start

    def size_with(self, entries: Sequence[Entry]) -> int:
        """Bytes at most of the file if it ended after `entries`."""
        return self._buffer.tell() + sum(len(entry.data) + _RECORD_BYTES for entry in entries) + _END_BYTES

    def add(self, entry: Entry) -> None:
        """Adds `entry` to the next commit."""
        self._writer.add_message(
            self._channels[entry.channel], entry.time, entry.data, entry.time, self._sequence[entry.channel]
        )
        self._sequence[entry.channel] += 1

    def commit(self) -> None:
        """Writes all added entries.

        Raises:
            OSError: not all could be written; the file is truncated to where it ended before.
        """
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

    def finish(self) -> None:
        """Adds summary and footer, and closes the file.

        Raises:
            OSError: likewise; what was committed before is in the file.
        """
        self.commit()
        self._writer.finish()  # type: ignore[no-untyped-call]
        self.commit()
        descriptor, self._descriptor = self._descriptor, -1
        os.close(descriptor)

    def abandon(self) -> None:
        """Closes the file as it is, and deletes it if nothing was committed."""
        with suppress(OSError):
            os.close(self._descriptor)
        if not self.size:
            with suppress(OSError):
                self.path.unlink()

    def _register(self, channel: Channel, device: str) -> int:
        message = channel.message
        schema = self._writer.register_schema(message.DESCRIPTOR.full_name, SchemaEncoding.Protobuf, schema_of(channel))
        return self._writer.register_channel(channel.topic(device), MessageEncoding.Protobuf, schema)


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
