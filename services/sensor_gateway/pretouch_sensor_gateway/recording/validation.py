"""Checks whether a file is a recording that can be played."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from google.protobuf.descriptor_pb2 import DescriptorProto, FileDescriptorSet
from google.protobuf.message import DecodeError

from pretouch.errors import InvalidInput, NotFound
from pretouch.recording.reader import Recorded, RecordingReader
from pretouch.regular_file import check_regular_file
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch_sensor_gateway.recording.channels import Channel, schema_of

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
    known = schema_of(Channel.RANGES)
    if message.described == known:
        return
    try:
        recorded = _fields(FileDescriptorSet.FromString(message.described))
    except DecodeError as error:
        raise InvalidInput(f"The recording {path} is damaged.", "Give another recording.") from error
    unknown = _reachable(recorded, f".{RANGES}") - _reachable(
        _fields(FileDescriptorSet.FromString(known)), f".{RANGES}"
    )
    if unknown:
        fields = ", ".join(sorted(name for name, *_ in unknown))
        raise InvalidInput(
            f"{path} was recorded by another version of pretouch: this one does not know {fields}.",
            "Update pretouch, or play it with the version that has recorded it.",
        )


_Field = tuple[str, int, int, int]
"""Full name, number, type and label."""


def _fields(described: FileDescriptorSet) -> dict[str, DescriptorProto]:
    return {f".{file.package}.{message.name}": message for file in described.file for message in file.message_type}


def _reachable(messages: dict[str, DescriptorProto], root: str) -> set[_Field]:
    """The fields of the message `root`, and of all messages nested in it."""
    found: set[_Field] = set()
    seen, waiting = {root}, [root]
    while waiting:
        name = waiting.pop()
        for field in messages[name].field if name in messages else ():
            found.add((f"{name[1:]}.{field.name}", field.number, field.type, field.label))
            if field.type_name not in seen:
                seen.add(field.type_name)
                waiting.append(field.type_name)
    return found
