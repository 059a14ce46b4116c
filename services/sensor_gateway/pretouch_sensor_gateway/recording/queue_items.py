"""What a recorder hands to the thread that writes."""

from __future__ import annotations

from dataclasses import dataclass

from pretouch.v1 import sensor_gateway_pb2 as pb


@dataclass(frozen=True)
class BatchItem:
    """A batch of `frames` measurements."""

    batch: pb.RangeBatch
    frames: int


@dataclass(frozen=True)
class ConfigurationItem:
    """The device's configuration became this, `at` s since the Unix epoch."""

    configuration: pb.DeviceConfiguration
    at: float


@dataclass(frozen=True)
class EventItem:
    """Something happened, `at` s since the Unix epoch."""

    text: str
    at: float


@dataclass(frozen=True)
class StopItem:
    """The recording ends here, until the next batch comes."""


Item = BatchItem | ConfigurationItem | EventItem | StopItem
