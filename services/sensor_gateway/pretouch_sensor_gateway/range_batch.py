"""The unit that flows through the gateway: measurements that arrived together, with their times."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import array_from_proto, array_to_proto
from pretouch_sensor_gateway.range_status import classify


class Flag(IntFlag):
    """What is doubtful about a range whose status is good."""

    JUMP = pb.RANGE_FLAG_JUMP
    """It lies far from the module's last range, and no later one has confirmed it."""
    WARMING_UP = pb.RANGE_FLAG_WARMING_UP
    """The device started so recently that its calibration does not hold yet."""
    BEYOND_CALIBRATION = pb.RANGE_FLAG_BEYOND_CALIBRATION
    """It lies beyond the distances that the module was calibrated at."""
    STD_UNKNOWN = pb.RANGE_FLAG_STD_UNKNOWN
    """The module's noise is not known: it is not calibrated, and has not sent enough yet."""


@dataclass(frozen=True, eq=False)
class RangeBatch:
    """f measurements of k modules, in their order, all of one boot session.

    Attributes:
        t: (f,) Unix time by the host's clock, s.
        time_std: one standard deviation of these times, s; an error common to all.
        sequence: (f,) uint32, the device's own count.
        epoch: number of the boot session: how often the device was seen to restart before it.
        range: (f, k) m along each module's beam, calibrated; NaN where there is none.
        raw: (f, k) m as the device reported them.
        status: (f, k) uint8, the modules' status codes; 0 is good.
        flags: (f, k) uint8, of `Flag`.
        lost: measurements missing before the last of these.
        std: (f, k) float32, m, one standard deviation of each range, by the calibration or the module's own noise; NaN
            where it is not known, and where there is no range.
        wire_format: of the device: it says what the status codes mean.
    """

    t: Array
    time_std: float
    sequence: NDArray[np.uint32]
    epoch: int
    range: Array
    raw: Array
    status: NDArray[np.uint8]
    flags: NDArray[np.uint8]
    lost: int
    std: NDArray[np.float32]
    wire_format: str = ""

    @staticmethod
    def from_message(message: pb.RangeBatch) -> RangeBatch:
        """The batch of a message, which it keeps as its own `message`.

        Raises:
            PretouchError: an array is not of its stated shape and type.
        """
        ranges = array_from_proto(message.range, "range")
        batch = RangeBatch(
            t=array_from_proto(message.t, "t"),
            time_std=message.time_std,
            sequence=array_from_proto(message.sequence, "sequence"),
            epoch=message.epoch,
            range=ranges,
            raw=array_from_proto(message.raw, "raw"),
            status=array_from_proto(message.status, "status"),
            flags=array_from_proto(message.flags, "flags"),
            lost=message.lost,
            std=array_from_proto(message.std, "std") if message.HasField("std") else _unknown(ranges),
        )
        batch.__dict__["message"] = message  # where cached_property looks first
        if message.HasField("range_status"):
            batch.__dict__["range_status"] = array_from_proto(message.range_status, "range_status")
        return batch

    @cached_property
    def message(self) -> pb.RangeBatch:
        """The batch as a message, made once for all subscribers and the recording, which must not change it."""
        return pb.RangeBatch(
            t=array_to_proto(self.t, "f8"),
            time_std=self.time_std,
            sequence=array_to_proto(self.sequence, "u4"),
            epoch=self.epoch,
            range=array_to_proto(self.range, "f8"),
            raw=array_to_proto(self.raw, "f8"),
            status=array_to_proto(self.status, "u1"),
            flags=array_to_proto(self.flags, "u1"),
            lost=self.lost,
            std=array_to_proto(self.std, "f4"),
            range_status=array_to_proto(self.range_status, "u1"),
        )

    @cached_property
    def range_status(self) -> NDArray[np.uint8]:
        """(f, k) numbers of `pb.RangeStatus`: what the status codes mean."""
        return classify(self.status, self.range, self.wire_format)

    def __len__(self) -> int:
        return len(self.t)

    @property
    def modules(self) -> int:
        return int(self.range.shape[1])


def _unknown(ranges: Array) -> NDArray[np.float32]:
    """The std of ranges of an old recording."""
    return np.full(ranges.shape, np.nan, dtype=np.float32)
