"""The status codes that every simulated module reports."""

from __future__ import annotations

from enum import IntEnum


class Status(IntEnum):
    """The VL6180X's range error codes that the models use (datasheet)."""

    OK = 0
    EARLY_CONVERGENCE = 6
    NO_TARGET = 7
    SNR = 11
    RANGE_UNDERFLOW = 14
