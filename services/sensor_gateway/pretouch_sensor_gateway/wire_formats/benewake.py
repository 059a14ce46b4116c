"""The 9-byte frames of Benewake's TF-Luna, TFmini, TFmini Plus and TFmini-S.

0x59 0x59, distance low and high byte, strength low and high byte, two bytes of temperature or mode, and the sum of the
eight bytes before. The distance is in centimetres unless the sensor was told otherwise. A strength below 100 or of
65535 means that the distance is not reliable; 0 and 65532 to 65535 are no distance. Source: Benewake, TF-Luna manual
SJ-PM-TF-Luna A05, section 6.4 and appendix I; TFmini-S manual SJ-PM-TFmini-S A01, tables 7 and 8.
"""

from __future__ import annotations

import math
import struct

from pretouch_sensor_gateway.wire_formats.parser import OK, Measurement
from pretouch_sensor_gateway.wire_formats.range_text import MAX_RANGE, METRES, NO_TARGET

_FRAME = struct.Struct("<2sHHHB")
_WEAK, _OVEREXPOSED = 100, 0xFFFF
_FIRST_ERROR = 0xFFFC


class BenewakeFrame:
    """A `FrameKind`.

    Args:
        unit: cm or, if the sensor was told so, mm.
        max_range: m; a larger range is not believed.
    """

    header = b"\x59\x59"
    length = _FRAME.size

    def __init__(self, name: str, unit: str, max_range: float = MAX_RANGE) -> None:
        self.name = name
        self.unit = unit
        self._max_range = max_range

    def is_sound(self, frame: bytes) -> bool:
        return sum(frame[:-1]) & 0xFF == frame[-1]

    def read(self, frame: bytes) -> Measurement | str:
        _, distance, strength, _, _ = _FRAME.unpack(frame)
        metres = distance * METRES[self.unit]
        if not distance or distance >= _FIRST_ERROR or strength < _WEAK or strength == _OVEREXPOSED:
            return Measurement(None, None, None, (math.nan,), (NO_TARGET,), self.length)
        if metres > self._max_range:
            return (
                f"A distance of {distance} is far, if it is in {self.unit}. Is it in mm? Then set format = "
                '"tf-luna-mm", else "tf-luna"; frames do not tell their unit.'
            )
        return Measurement(None, None, None, (metres,), (OK,), self.length)
