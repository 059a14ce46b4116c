"""The streams of sound devices."""

from __future__ import annotations

import math

from pretouch_sensor_gateway.wire_formats.binary import encode
from pretouch_sensor_gateway.wire_formats.messages import MAX_MODULES, Message
from pretouch_sensor_gateway.wire_formats.parser import Identity, Measurement, PingReply

_LINES = 14
MESSAGES: tuple[Message, ...] = (
    Identity(0x1234, "0102030405060708", 2, 0.033333, "demo 1.0"),
    PingReply(0x1234, 3, 1_000_500),
    Measurement(0x1234, 5, 1_000_000, (0.0345, math.nan), (0, 7)),
    Measurement(0x1234, 6, 1_033_333, (6.5,) * MAX_MODULES, (255,) * MAX_MODULES),
)


def _lines(text: str) -> bytes:
    return b"".join(text.format(ms=1000 + 33 * k, k=k, mm=120 + k * 7 % 5, s=k // 10).encode() for k in range(_LINES))


def _benewake(centimetres: int) -> bytes:
    frame = b"YY" + centimetres.to_bytes(2, "little") + bytes.fromhex("b0046009")
    return frame + bytes([sum(frame) % 256])


STREAMS: dict[str, list[bytes]] = {
    "binary": [b"\0" + b"".join(map(encode, MESSAGES))],
    "millimetres": [
        _lines("{mm} 45.5 255 8190\n"),
        _lines("{mm},,-1,TIMEOUT,\r\n"),
        _lines("{mm}\t65535 TIMEOUT; nan\r"),
    ],
    "time-millimetres": [_lines("{ms} {mm} 45.5\n"), _lines("{ms}.25, {mm}, ---\r\n")],
    "millimetres-time": [_lines("{mm} 45.5 {ms}\n"), _lines("{mm};none;{ms}\r\n")],
    "adafruit-vl6180x-triple": [
        _lines("33 : {mm} : ### : 50\r\n"),
        _lines("33(2) : {mm} : TTT : #6\r\n"),
        _lines("33(1) : 0   : {mm}   : 8190#4\r\n"),
        _lines(" Addr: 30 Lux: 12.30 Range: {mm} Addr: 31 Lux: 0.00(No convergence)\r\n"),
    ],
    "stm32duino": [_lines("[00:00:0{s}.{k:03d}, {k:05d}]      {mm} [0]            1838 [4]            \r\n")],
    "pololu-vl53l1x-details": [_lines("range: {mm}\tstatus: range valid\tpeak signal: 7.31\tambient: 0.42\r\n")],
    "esp-idf": [_lines("\x1b[0;32mI ({ms}) tof: {mm} mm\x1b[0m\n")],
    "x-nucleo": [_lines("| Distance top [mm]: {mm} |\r\n| Distance left [mm]: 55 |\r\n")],
    "sparkfun-vl53l5cx-4x4": [_lines("\r\n" + "\t{mm}\t45\t46\t0\r\n" * 4)],
    "tf-luna": [b"".join(map(_benewake, range(9, 19)))],
}
"""Streams of each format that some `Parser` reads from the first line end on."""
BARE = ("millimetres", "time-millimetres", "millimetres-time")
"""Formats that `auto` does not choose, because their lines do not tell their unit."""
