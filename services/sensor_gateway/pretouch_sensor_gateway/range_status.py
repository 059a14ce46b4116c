"""What the sensors' own status codes mean, in words that are the same for all sensors."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pretouch.v1 import sensor_gateway_pb2 as pb

_GOOD, _NO_TARGET = pb.RANGE_STATUS_GOOD, pb.RANGE_STATUS_NO_TARGET
_REJECTED, _FAILED = pb.RANGE_STATUS_REJECTED, pb.RANGE_STATUS_FAILED
_COMMON = {0: _GOOD, 7: _NO_TARGET, 255: pb.RANGE_STATUS_NO_ANSWER}
"""Also of formats without status codes: the gateway then writes these."""
_VL6180X = _COMMON | dict.fromkeys(range(1, 6), _FAILED)
"""Data sheet of the VL6180X, RESULT__RANGE_STATUS: 1-5 the system failed, 6 and 8-15 the range cannot be relied on."""
_VL53L = _COMMON | {4: _NO_TARGET, 5: _FAILED}
"""User manuals of the VL53L1X to VL53L8CX: 4 phase out of bounds, 5 hardware failed; else noise or signal."""


def _table(meanings: dict[int, pb.RangeStatus.ValueType]) -> NDArray[np.uint8]:
    return np.array([meanings.get(code, _REJECTED) for code in range(256)], dtype=np.uint8)


_VL6180X_TABLE, _VL53L_TABLE = _table(_VL6180X), _table(_VL53L)


def classify(status: NDArray[Any], ranges: NDArray[Any], wire_format: str) -> NDArray[np.uint8]:
    """The numbers of `pb.RangeStatus`, in the shape of `status`.

    Args:
        status: the modules' own codes, 0 to 255; 0 is good.
        ranges: m, of the same shape; NaN where there is none.
        wire_format: the format of the device, by whose name the family of its sensor is known.
    """
    table = _VL53L_TABLE if "vl53" in wire_format or wire_format == "stm32duino" else _VL6180X_TABLE
    meaning = table[status]
    return np.where((meaning == _GOOD) & np.isnan(ranges), np.uint8(_NO_TARGET), meaning)
