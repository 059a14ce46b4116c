"""What a recorder hands to the thread that writes."""

from __future__ import annotations

from dataclasses import dataclass

from pretouch.v1 import sensor_gateway_pb2 as pb


@dataclass(frozen=True)
class Measured:
    """A batch of `frames` measurements."""

    batch: pb.RangeBatch
    frames: int


@dataclass(frozen=True)
class Configured:
    """The device's configuration became this, `at` s since the Unix epoch."""

    configuration: pb.DeviceConfiguration
    at: float


@dataclass(frozen=True)
class Happened:
    """Something happened, `at` s since the Unix epoch."""

    text: str
    at: float


@dataclass(frozen=True)
class Stopped:
    """The recording ends here, until the next batch comes."""


Item = Measured | Configured | Happened | Stopped
