"""Batches to record, and what is found in a recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import structlog
from foxglove_schemas_protobuf.Log_pb2 import Log
from pretouch_sensor_gateway.recording.limits import Limits
from pretouch_sensor_gateway.recording.queue_items import BatchItem
from pretouch_sensor_gateway.recording.rotating_files import RotatingFiles

from pretouch.geometry import Pose
from pretouch.recording.reader import Recorded, RecordingReader
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import array_to_proto, pose_to_proto

T0 = 1_780_000_000.0  # s since the Unix epoch
MODULES = 6
RANGES = "pretouch.v1.RangeBatch"


def made_batch(first: int, frames: int = 1, modules: int = MODULES, rate: float = 30.0) -> pb.RangeBatch:
    """Frames `first`, `first` + 1, ... at `rate` Hz from T0 on; each module's range is k cm, the last one's a miss."""
    count = first + np.arange(frames)
    ranges = np.tile(0.01 * np.arange(1.0, modules + 1), (frames, 1))
    ranges[:, -1] = np.nan
    zeros = np.zeros((frames, modules))
    return pb.RangeBatch(
        t=array_to_proto(T0 + count / rate, "f8"),
        time_std=1e-4,
        sequence=array_to_proto(count, "u4"),
        epoch=1,
        range=array_to_proto(ranges, "f8"),
        raw=array_to_proto(ranges + 0.001, "f8"),
        status=array_to_proto(zeros, "u1"),
        flags=array_to_proto(zeros, "u1"),
    )


def measured(first: int, frames: int = 1) -> BatchItem:
    return BatchItem(made_batch(first, frames), frames)


def made_configuration(modules: int = MODULES) -> pb.DeviceConfiguration:
    """Modules 1 cm apart along x, tilted by 0.1 rad a step."""
    poses = [Pose.from_rotation_vector([0.0, 0.1 * k, 0.0], [0.01 * k, 0.0, 0.0]) for k in range(modules)]
    return pb.DeviceConfiguration(tip_t_module=map(pose_to_proto, poses), recording=True)


def series_in(root: Path, limits: Limits | None = None, device: str = "left") -> RotatingFiles:
    """Files to which every write is committed at once."""
    return RotatingFiles(root, device, limits or Limits(), structlog.get_logger(), commit_every=0.0)


def files_in(root: Path, device: str = "left") -> list[Path]:
    return sorted((root / device).iterdir())


def recorded_in(path: Path) -> list[Recorded]:
    return list(RecordingReader(path))


def batches_in(path: Path) -> list[bytes]:
    """The recorded batches, serialised, in the order of the file."""
    return [message.data for message in RecordingReader(path) if message.schema == RANGES]


def log_in(path: Path) -> list[str]:
    """The recorded events."""
    return [Log.FromString(one.data).message for one in RecordingReader(path) if one.schema == "foxglove.Log"]


def sequence_in(path: Path) -> list[int]:
    """The sequence numbers of all recorded frames."""
    batches = map(pb.RangeBatch.FromString, batches_in(path))
    return [int(number) for batch in batches for number in np.frombuffer(batch.sequence.data, "<u4")]
