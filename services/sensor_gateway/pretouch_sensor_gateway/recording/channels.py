"""What a recording holds: its channels, their schemas, and entries of them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Any

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message

from pretouch.v1 import sensor_gateway_pb2 as pb


class Channel(Enum):
    """A channel of a recording: the last part of its topic, and the message that it carries."""

    RANGES = ("ranges", pb.RangeBatch)
    """The batches as subscribers got them: all that a replay needs."""
    CONFIGURATION = ("configuration", pb.DeviceConfiguration)
    """At the start of each file, and whenever it changes."""
    POINTS = ("points", PointCloud)
    """Where the beams came back from, to look at in Foxglove."""
    TRANSFORMS = ("tf", FrameTransforms)
    """The modules in the tip's frame, to look at in Foxglove; along with the configuration."""
    LOG = ("log", Log)
    """What happened to the device."""

    def __init__(self, leaf: str, message: type[Message]) -> None:
        self.leaf = leaf
        self.message = message

    def topic(self, device: str) -> str:
        return f"/{device}/{self.leaf}"


@dataclass(frozen=True)
class Entry:
    """One message of a recording: serialised, at a time in ns since the Unix epoch."""

    channel: Channel
    time: int
    data: bytes


@cache
def schema_of(channel: Channel) -> bytes:
    """The file of the channel's message and all that it imports, as the FileDescriptorSet that MCAP asks for."""
    files: dict[str, Any] = {}

    def add(file: Any) -> None:
        if file.name not in files:
            for imported in file.dependencies:
                add(imported)
            files[file.name] = file

    add(channel.message.DESCRIPTOR.file)
    described = FileDescriptorSet()
    for file in files.values():
        file.CopyToProto(described.file.add())
    return described.SerializeToString()
