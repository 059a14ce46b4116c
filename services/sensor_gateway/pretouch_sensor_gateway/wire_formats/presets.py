"""Line formats by name: of well-known sketches and boards, and of bare numbers whose unit the user states.

docs/reference/wire-formats.md says where each comes from.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from pretouch_sensor_gateway.wire_formats.line_format import LineFormat
from pretouch_sensor_gateway.wire_formats.range_text import NO_ANSWER, NO_TARGET

_VL6180X_ERRORS = {
    "system error": 1,
    "ece failure": 6,
    "no convergence": 7,
    "ignoring range": 8,
    "signal/noise error": 11,
    "raw reading underflow": 12,
    "raw reading overflow": 13,
    "range reading underflow": 14,
    "range reading overflow": 15,
}
"""What Adafruit's VL6180X sketches print for the sensor's status codes."""
_VL53L1X_STATUS = {
    "range valid, min range clipped": 3,
    "sigma fail": 1,
    "sigma failure": 1,
    "signal fail": 2,
    "signal failure": 2,
    "out of bounds fail": 4,
    "out of bounds": 4,
    "phase out of valid limits": 4,
    "hardware fail": 5,
    "wrap target fail": 7,
    "wrapped target fail": 7,
    "wrap-around": 7,
    "synchronization int": 10,
}
"""What Pololu's and SparkFun's VL53L1X libraries print for the sensor's status codes."""

BARE = (
    LineFormat("millimetres", ("{ranges:mm}",)),
    LineFormat("centimetres", ("{ranges:cm}",)),
    LineFormat("metres", ("{ranges:m}",)),
    LineFormat("time-millimetres", ("{time:ms} {ranges:mm}",)),
    LineFormat("millimetres-time", ("{ranges:mm} {time:ms}",)),
    LineFormat("micros-millimetres", ("{time:us} {ranges:mm}",)),
    LineFormat("seconds-millimetres", ("{time:s} {ranges:mm}",)),
    LineFormat("millimetres-status", ("{range:mm} {status}",)),
    LineFormat("pololu-vl53l0x", ("{range:mm}",), full_scale=False),
    LineFormat("pololu-vl53l1x", ("{range:mm}",), full_scale=False),
    LineFormat("pololu-vl6180x", ("{range:mm}",)),
    LineFormat("teraranger-evo", ("{range:mm}",), full_scale=False),
    LineFormat("tfmini-text", ("{range:m}",)),
    LineFormat("seeed-vl53l0x", ("Distance = {range:mm} mm",), full_scale=False),
    LineFormat(
        "adafruit-vl53l1x",
        ("Distance: {range:mm} mm",),
        no_target_lines=(r"Couldn't get distance: .*",),
        full_scale=False,
    ),
    LineFormat("vl53l5cx-rows-8x8", ("{ranges:mm}",), full_scale=False, rows=8),
    LineFormat("vl53l5cx-rows-4x4", ("{ranges:mm}",), full_scale=False, rows=4),
)
"""Formats that `auto` never chooses: their lines do not tell the unit, or do, but not which sensor it is."""

TELLING = (
    LineFormat(
        "pololu-vl53l1x-details",
        ("range: {range:mm} status: {status} peak signal: {any} ambient: {any}",),
        full_scale=False,
        status_of=_VL53L1X_STATUS,
    ),
    LineFormat("pololu-vl6180x-ambient", ("Ambient: {any} Range: {range:mm}",)),
    LineFormat(
        "adafruit-vl6180x",
        ("Range: {range:mm}",),
        skipped=(r"Lux: [\d.]+", "Adafruit VL6180x test!", "Sensor found!"),
        no_target_lines=(*_VL6180X_ERRORS, "some other error"),
        companion=r"Lux: [\d.]+",
    ),
    LineFormat(
        "adafruit-vl6180x-triple",
        (
            "{number}(({pending}))?( : ({range:mm})?(#{status})?)+",
            "(Addr: {any} Lux: {number}( Range: {range:mm})?({status})?( )?)+",
        ),
        status_of=_VL6180X_ERRORS | {"ttt": NO_ANSWER, "###": NO_TARGET},
        exact=True,
        marked=r"\s*(?:\d+\([0-9A-Fa-f]+\) : .*|\d+ : .*#.*|Addr: .* Lux: .*)",  # else it is nothing but numbers
    ),
    LineFormat(
        "adafruit-vl53l0x",
        ("Reading a measurement... Distance (mm): {range:mm}",),
        no_target_lines=(r"Reading a measurement\.\.\. +out of range",),
        full_scale=False,
    ),
    LineFormat("sparkfun-vl53l1x", ("Distance(mm): {range:mm} Distance(ft): {any}",), full_scale=False),
    LineFormat(
        "sparkfun-vl53l1x-status",
        (
            "Distance(mm): {range:mm} Range Status: {status} Hz: {any}",
            "Distance(mm): {range:mm} Avg: {number} Range Status: {status} Signal Rate: {any}",
        ),
        full_scale=False,
        status_of=_VL53L1X_STATUS,
    ),
    LineFormat(
        "sparkfun-vl6180x",
        ("Distance measured (mm) = {range:mm}",),
        skipped=(r"Ambient Light Level \(Lux\) = .*",),
    ),
    LineFormat(
        "sparkfun-vl53l5cx-8x8", (r"{ranges:mm}",), full_scale=False, rows=8, mirrored=True, marked=r"(?:\t-?\d+){8}"
    ),
    LineFormat(
        "sparkfun-vl53l5cx-4x4", (r"{ranges:mm}",), full_scale=False, rows=4, mirrored=True, marked=r"(?:\t-?\d+){4}"
    ),
    LineFormat(
        "circuitpython-vl53l1x",
        ("{range:cm}",),
        marked=r"\d+\.\d+|None",
        companion=r"VL53L1X Simple Test\.?",
    ),
    LineFormat("x-nucleo", ("| Distance {module} [mm]: {range:mm} |",), full_scale=False),
    LineFormat("x-nucleo-single", ("| Distance [mm]: {range:mm} |",), full_scale=False),
    LineFormat(
        "stm32duino-vl53l4cd", ("Status = {status}, Distance = {range:mm} mm, Signal = {any}",), full_scale=False
    ),
    LineFormat("stm32duino", ("[{time:hms}, {sequence}]( {range:mm} [{status}])+",), full_scale=False),
    LineFormat("teraranger-hub", ("TH {ranges:mm}",), full_scale=False),
    LineFormat("tfmini-plus", ("Dist:{range:cm}cm Flux:{any}",)),
    LineFormat(
        "esphome",
        ("{any}'{module}': Sending state {range:m} m with {any}", "{any}'{module}' >> {range:m} m"),
        skipped=(r"\[.*\]\[.*\].*",),
    ),
    LineFormat("esp-idf", ("{any} ({time:ms}) {module}: {range:mm} mm",), skipped=(r"[VDIWE] \(\d+\) .*",)),
)
"""Formats whose lines tell their unit, or that only one known sketch prints: `auto` chooses them."""

PRESETS: Mapping[str, LineFormat] = MappingProxyType({each.name: each for each in (*BARE, *TELLING)})
RENAMED = {"adafruit": "adafruit-vl6180x-triple"}
"""Names of earlier versions."""
