"""The channels of a recording, their schemas, and their entries."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from google.protobuf.message import Message

from pretouch.recording.schema import describe_schema
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.recording_pb2 import RecordedTipPoses


class Channel(Enum):
    """A channel of a recording: the last part of its topic, and the message that it carries."""

    RANGES = ("ranges", pb.RangeBatch)
    """The batches as subscribers got them."""
    CONFIGURATION = ("configuration", pb.DeviceConfiguration)
    """At the start of each file, and whenever it changes."""
    TIP_POSES = ("tip_poses", RecordedTipPoses)
    """The tip poses that StreamPoints was sent."""
    POINTS = ("points", PointCloud)
    """The points that reflected the beams, in the tip's coordinate frame, to view."""
    BASE_POINTS = ("base_points", PointCloud)
    """The points that StreamPoints answered, in base, to view."""
    TRANSFORMS = ("tf", FrameTransforms)
    """To view: the modules in the tip's coordinate frame, along with the configuration, and the tip in base."""
    LOG = ("log", Log)
    """Events of the device."""

    def __init__(self, leaf: str, message: type[Message]) -> None:
        self.leaf = leaf
        self.message = message

    def topic(self, device: str) -> str:
        return f"/{device}/{self.leaf}"


@dataclass(frozen=True)
class Entry:
    """One serialised message of a recording, and its Unix time, ns."""

    channel: Channel
    time: int
    data: bytes


def schema_of(channel: Channel) -> bytes:
    """The channel's schema as MCAP requires it."""
    return describe_schema(channel.message)
