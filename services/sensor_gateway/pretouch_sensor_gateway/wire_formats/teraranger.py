"""The 4-byte frames of Terabee's TeraRanger Evo.

"T", the distance in millimetres, high byte first, and a CRC-8 (polynomial 0x07) of these three bytes. 0: too close,
0xFFFF: too far, 1: not measured. Source: Terabee, TeraRanger Evo data sheets, section 4.4.3, UART output format.
"""

from __future__ import annotations

import math

from fastcrc import crc8

from pretouch_sensor_gateway.wire_formats.parser import OK, Measurement
from pretouch_sensor_gateway.wire_formats.range_text import NO_TARGET

_TOO_CLOSE, _NOT_MEASURED, _TOO_FAR = 0, 1, 0xFFFF


class TerarangerFrame:
    """A `FrameKind`."""

    name = "teraranger-evo-binary"
    unit = "mm"
    header = b"T"
    length = 4

    def is_sound(self, frame: bytes) -> bool:
        return bool(crc8.smbus(frame[:3]) == frame[3])

    def read(self, frame: bytes) -> Measurement | str:
        millimetres = int.from_bytes(frame[1:3], "big")
        if millimetres in (_TOO_CLOSE, _NOT_MEASURED, _TOO_FAR):
            return Measurement(None, None, None, (math.nan,), (NO_TARGET,), self.length)
        return Measurement(None, None, None, (millimetres / 1000,), (OK,), self.length)
