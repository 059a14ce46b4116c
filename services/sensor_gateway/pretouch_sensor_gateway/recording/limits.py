"""Limits on the disk space of a device's recordings."""

from __future__ import annotations

from dataclasses import dataclass

from pretouch.errors import InvalidInput

_LEAST_FILE_BYTES = 64 * 1024


@dataclass(frozen=True)
class Limits:
    """Limits of one device; each device has its own.

    Attributes:
        file_bytes: a file that would become larger is finished, and the next one started.
        file_seconds: likewise for a file that spans this time.
        total_bytes: of all files of the device; before this is exceeded, the oldest finished ones are deleted.

    Raises:
        InvalidInput: files that are too small, or a total of less than two files.
    """

    file_bytes: int = 64 * 1024**2
    file_seconds: float = 3600.0
    total_bytes: int = 4 * 1024**3

    def __post_init__(self) -> None:
        if self.file_bytes < _LEAST_FILE_BYTES:
            raise InvalidInput(
                f"A recording's files of {self.file_bytes} bytes are too small.", f"Allow {_LEAST_FILE_BYTES} or more."
            )
        if self.total_bytes < 2 * self.file_bytes:
            raise InvalidInput(
                f"{self.total_bytes} bytes for all recordings of a device do not hold two files of {self.file_bytes}.",
                "Allow at least two files: one is kept while the next is written.",
            )
        if not self.file_seconds > 0:
            raise InvalidInput(
                f"A recording's files cannot span {self.file_seconds} s.", "Give a positive number of seconds."
            )
