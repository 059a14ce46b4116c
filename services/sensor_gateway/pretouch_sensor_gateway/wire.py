"""The gateway's own types as messages of sensor_gateway.proto."""

from __future__ import annotations

from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import array_from_proto, array_to_proto, samples_to_proto
from pretouch_sensor_gateway.batch import Batch
from pretouch_sensor_gateway.fusion import Fused


def batch_to_proto(batch: Batch) -> pb.RangeBatch:
    return pb.RangeBatch(
        t=array_to_proto(batch.t, "f8"),
        time_std=batch.time_std,
        sequence=array_to_proto(batch.sequence, "u4"),
        epoch=batch.epoch,
        range=array_to_proto(batch.range, "f8"),
        raw=array_to_proto(batch.raw, "f8"),
        status=array_to_proto(batch.status, "u1"),
        flags=array_to_proto(batch.flags, "u1"),
        lost=batch.lost,
    )


def batch_from_proto(message: pb.RangeBatch) -> Batch:
    """The batch that `batch_to_proto` made a message of.

    Raises:
        PretouchError: an array is not of its stated shape and type.
    """
    return Batch(
        t=array_from_proto(message.t, "t"),
        time_std=message.time_std,
        sequence=array_from_proto(message.sequence, "sequence"),
        epoch=message.epoch,
        range=array_from_proto(message.range, "range"),
        raw=array_from_proto(message.raw, "raw"),
        status=array_from_proto(message.status, "status"),
        flags=array_from_proto(message.flags, "flags"),
        lost=message.lost,
    )


def points_to_proto(fused: Fused, lost: int, overrun: int) -> pb.StreamPointsResponse:
    return pb.StreamPointsResponse(
        samples=samples_to_proto(fused.samples),
        points=array_to_proto(fused.points, "f8"),
        lost=lost,
        unposed=fused.unposed,
        origins=array_to_proto(fused.origins, "f8"),
        directions=array_to_proto(fused.directions, "f8"),
        std=array_to_proto(fused.std, "f8"),
        flags=array_to_proto(fused.flags, "u1"),
        overrun=overrun,
    )
