"""Checks whether a file is a recording that can be played."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from google.protobuf.message import DecodeError

from pretouch.errors import InvalidInput, NotFound
from pretouch.recording.compatibility import find_unknown_fields
from pretouch.recording.reader import Recorded, RecordingReader
from pretouch.regular_file import check_regular_file
from pretouch.v1 import sensor_gateway_pb2 as pb

RANGES = pb.RangeBatch.DESCRIPTOR.full_name
CONFIGURATION = pb.DeviceConfiguration.DESCRIPTOR.full_name


class Beginning(NamedTuple):
    """How a recording begins: the configuration that holds at its first batch, and that batch's Unix time, s."""

    configuration: pb.DeviceConfiguration
    time: float


def check_recording(path: Path) -> Beginning:
    """Checks the recording at `path`.

    Raises:
        InvalidInput: it cannot be read, is no MCAP file, or holds no batch of ranges that this gateway knows.
    """
    try:
        check_regular_file(path)
    except NotFound as error:
        raise InvalidInput(f"The recording cannot be read. {error.detail}", "Give the path of an MCAP file.") from error
    configuration = pb.DeviceConfiguration()
    reader = RecordingReader(path)
    try:
        for message in reader:
            if message.schema == CONFIGURATION:
                configuration = pb.DeviceConfiguration.FromString(message.data)
            elif message.schema == RANGES:
                check_ranges(message, path)
                return Beginning(configuration, message.time / 1e9)
    except OSError as error:
        raise InvalidInput(
            f"The recording {path} cannot be read: {error.strerror}.", "Give the path of an MCAP file."
        ) from error
    except DecodeError as error:
        raise InvalidInput(f"The recording {path} is damaged.", "Give another recording.") from error
    if not reader.complete:
        raise InvalidInput(f"The recording {path} was cut off before its first batch.", "Give another recording.")
    raise InvalidInput(
        f"{path} holds no ranges: none of its channels has the schema {RANGES}.", "Give a recording of the gateway."
    )


def check_ranges(message: Recorded, path: Path) -> None:
    """Checks that the message's schema has no fields that this gateway does not know.

    Raises:
        InvalidInput: it has; a newer gateway has recorded it.
    """
    try:
        unknown = find_unknown_fields(message.described, pb.RangeBatch)
    except DecodeError as error:
        raise InvalidInput(f"The recording {path} is damaged.", "Give another recording.") from error
    if unknown:
        raise InvalidInput(
            f"{path} was recorded by another version of pretouch: this one does not know {', '.join(unknown)}.",
            "Update pretouch, or play it with the version that has recorded it.",
        )
