"""The items that a recorder queues for the writer thread."""

from __future__ import annotations

from dataclasses import dataclass

from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.recording_pb2 import RecordedTipPoses
from pretouch_sensor_gateway.fusion import FusedSamples


@dataclass(frozen=True)
class BatchItem:
    """A batch and its number of measurements."""

    batch: pb.RangeBatch
    measurements: int


@dataclass(frozen=True)
class ConfigurationItem:
    """The device's configuration from Unix time `at`, s."""

    configuration: pb.DeviceConfiguration
    at: float


@dataclass(frozen=True)
class TipPosesItem:
    """Tip poses of a StreamPoints call, at least one."""

    poses: RecordedTipPoses


@dataclass(frozen=True)
class PointsItem:
    """Samples that a StreamPoints call answered, at least one."""

    fused: FusedSamples


@dataclass(frozen=True)
class EventItem:
    """An event at Unix time `at`, s."""

    text: str
    at: float


@dataclass(frozen=True)
class StopItem:
    """The end of the recording, until the next batch."""


Item = BatchItem | ConfigurationItem | TipPosesItem | PointsItem | EventItem | StopItem
