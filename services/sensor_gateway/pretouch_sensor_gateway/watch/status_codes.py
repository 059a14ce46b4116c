"""The meaning of modules' status codes, in words short enough for a table."""

from __future__ import annotations

_VL6180X = {
    0: "ok",
    **dict.fromkeys(range(1, 6), "sensor failed"),
    6: "no early convergence",
    7: "no target",
    8: "ignored",
    11: "noise",
    12: "raw underflow",
    13: "raw overflow",
    14: "range underflow",
    15: "range overflow",
    255: "absent",
}
"""Also for formats without status codes: the gateway then uses 0, 7 or 255."""
_VL53L1X = {0: "ok", 1: "noise", 2: "weak signal", 4: "out of bounds", 7: "wrapped around", 255: "absent"}
_OF_FORMAT = {"stm32duino": _VL53L1X}


def explain_code(code: int, wire_format: str) -> str:
    """The words for a status code of a device that speaks `wire_format`."""
    return _OF_FORMAT.get(wire_format, _VL6180X).get(code, "unknown code")
