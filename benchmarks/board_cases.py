"""What boards and sketches print, made in code: what came when, and what was true."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict, Unpack

from fastcrc import crc8

SECONDS = 5.0
"""How long each board sends."""
_BOOT = (
    "ets Jul 29 2019 12:21:46\r\n\r\nrst:0x1 (POWERON_RESET),boot:0x13 (SPI_FAST_FLASH_BOOT)\r\nentry 0x400805e4\r\n"
)
_NO_TARGET_EVERY = 12
"""Of so many measurements one has no target."""


@dataclass(frozen=True)
class BoardCase:
    """One board.

    Attributes:
        writes: what it sends: time, s, and bytes.
        truth: each measurement of its first module: time, s, and range, mm; None: no target.
        named: the format that its user would name.
        modules: as the user would state them; None: not.
        auto: whether `auto` reads it without a question.
        message: what `problem` must match, where the board cannot be read or asks for attention.
        readable: whether it can be read at all when its format is named.
    """

    name: str
    writes: tuple[tuple[float, bytes], ...]
    truth: tuple[tuple[float, float | None], ...]
    named: str
    modules: int | None = None
    auto: bool = True
    message: str = ""
    readable: bool = True

    @property
    def data(self) -> bytes:
        """All that it sends."""
        return b"".join(data for _, data in self.writes)


Print = Callable[[int, float, float | None], str | bytes]
"""What is printed of measurement k at time t, s, of this range, mm, None without a target."""


def _range(k: int, t: float) -> float | None:
    return None if k % _NO_TARGET_EVERY == 7 else 80 + 25 * math.sin(2 * math.pi * t / 2.5) + (k * 7 % 5 - 2) * 0.4


def _range_beyond_20_cm(k: int, t: float) -> float | None:
    """What a TF-Luna can see: nothing nearer."""
    near = _range(k, t)
    return None if near is None else near + 300


class _Outcome(TypedDict, total=False):
    """What a `BoardCase` says of how the board is read."""

    modules: int | None
    auto: bool
    message: str
    readable: bool


def _case(
    name: str,
    printed: Print,
    named: str,
    rate: float = 30.0,
    boot: str | bytes = "",
    true: Callable[[int, float], float | None] = _range,
    **outcome: Unpack[_Outcome],
) -> BoardCase:
    times = [0.2 + k / rate for k in range(round(rate * (SECONDS - 0.3)))]
    truth = [(t, true(k, t)) for k, t in enumerate(times)]
    writes = [(0.05, _bytes(boot))] if boot else []
    writes += [(t, _bytes(printed(k, t, metres))) for k, (t, metres) in enumerate(truth)]
    return BoardCase(name, tuple((t, data) for t, data in writes if data), tuple(truth), named, **outcome)


def _bytes(printed: str | bytes) -> bytes:
    return printed if isinstance(printed, bytes) else printed.encode("utf-8")


def _mm(value: float | None, none: object = 8190) -> str:
    return str(none) if value is None else f"{value:.0f}"


def _cm(value: float | None, digits: int = 1, none: str = "None") -> str:
    return none if value is None else f"{value / 10:.{digits}f}"


def _rows(side: int, prefix: str, value: float | None) -> str:
    rows = [
        [0 if value is None else round(value) + side * row + column for column in range(side)] for row in range(side)
    ]
    return "\r\n".join(prefix + ("\t" if prefix else " ").join(map(str, row)) for row in rows) + "\r\n\r\n"


def _benewake(distance: int, strength: int = 1200) -> bytes:
    frame = struct.pack("<2sHHH", b"YY", distance, strength, 2400)
    return frame + bytes([sum(frame) & 0xFF])


def _teraranger(value: float | None) -> bytes:
    frame = b"T" + (0xFFFF if value is None else round(value)).to_bytes(2, "big")
    return frame + bytes([crc8.smbus(frame)])


def _micropython(k: int, t: float, value: float | None) -> str:
    if t > 3.0:
        stopped = 'Traceback (most recent call last):\r\n  File "main.py", line 14\r\nOSError: [Errno 110] ETIMEDOUT'
        return f"{stopped}\r\nMicroPython v1.22.2 on 2024-02-22; Raspberry Pi Pico\r\n>>> " if t < 3.0 + 1 / 29 else ""
    return f"distance: {_mm(value, 'None')} mm\r\n"


def _esphome(k: int, t: float, value: float | None) -> str:
    head = f"\x1b[0;36m[12:00:{int(t):02d}][D][sensor:094]: "
    metres = "nan" if value is None else f"{value / 1000:.5f}"
    other = (
        f"{head}'Board temperature': Sending state 41.20000 °C with 1 decimals of accuracy\x1b[0m\r\n"
        if k % 9 == 0
        else ""
    )
    return f"{other}{head}'Fingertip': Sending state {metres} m with 3 decimals of accuracy\x1b[0m\r\n"


CASES = (
    _case("Seeed Grove VL53L0X", lambda k, t, v: f"Distance = {_mm(v)} mm\r\n", "seeed-vl53l0x", 10),
    _case(
        "Adafruit VL53L1X",
        lambda k, t, v: "Couldn't get distance: 4\r\n" if v is None else f"Distance: {_mm(v)} mm\r\n",
        "adafruit-vl53l1x",
        20,
        "Adafruit VL53L1X sensor demo\r\nVL53L1X sensor OK!\r\n",
    ),
    _case("ESPHome", _esphome, "esphome"),
    _case("MicroPython, then a REPL", _micropython, "distance: {range:mm} mm", message=r"ETIMEDOUT.*>>>"),
    _case("CircuitPython VL53L0X", lambda k, t, v: f"Range: {_mm(v)}mm\r\n", "Range: {range:mm}mm", 10),
    _case(
        "TFMini Plus, text",
        lambda k, t, v: f"Dist:{0 if v is None else round(v / 10):04d}cm Flux:01200 Temp:35C\r\n",
        "tfmini-plus",
        100,
    ),
    _case(
        "TF-Luna in mm",
        lambda k, t, v: _benewake(0 if v is None else round(v)),
        "tf-luna-mm",
        100,
        auto=False,
        message=r"mm.*tf-luna-mm",
        true=_range_beyond_20_cm,
    ),
    _case(
        "TF-Luna, weak signal",
        lambda k, t, v: _benewake(9 if v is None else round(v / 10), 40 if v is None else 900),
        "tf-luna",
        100,
    ),
    _case("TeraRanger Evo, binary", lambda k, t, v: _teraranger(v), "teraranger-evo-binary", 60),
    _case(
        "decimal comma, cm",
        lambda k, t, v: _cm(v, 1, "-1").replace(".", ",") + "\r\n",
        "{range:cm,}",
        auto=False,
        message=r"decimal comma",
    ),
    _case(
        "decimal comma, labelled",
        lambda k, t, v: f"Abstand: {_cm(v, 1, '0').replace('.', ',')} cm\r\n",
        "Abstand: {range:cm,} cm",
        auto=False,
        message=r"decimal comma",
    ),
    _case(
        "CSV, ms, status, light",
        lambda k, t, v: f"{1000 * t:.0f},{_mm(v)},{4 * (v is None)},{613 + k % 9}\r\n",
        "{time:ms},{range:mm},{status},{any}",
        auto=False,
        message=r"time in ms",
        boot=_BOOT,
    ),
    _case(
        "CSV, s", lambda k, t, v: f"{t:.3f};{_mm(v, 'nan')}\r\n", "seconds-millimetres", auto=False, message="time in s"
    ),
    _case(
        "CSV, us, that wraps",
        lambda k, t, v: f"{(4_293_000_000 + round(1e6 * t)) % 2**32},{_mm(v)}\r\n",
        "{time:us},{range:mm}",
        auto=False,
        message=r"mm, cm or m",
    ),
    _case(
        "CSV with a header",
        lambda k, t, v: f"{1000 * t:.0f},{_mm(v, -1)},{4 * (v is None)}\r\n",
        "{time:ms},{range:mm},{status}",
        boot="\r\ntime_ms,distance_mm,status\r\n",
    ),
    _case(
        "left and right on a line",
        lambda k, t, v: f"L: {_mm(v)} mm R: {_mm(v and v + 20)} mm\r\n",
        "L: {range:mm} mm R: {range:mm} mm",
        auto=False,
        message=r"Which numbers are ranges.*L: \{range:mm\}",
    ),
    _case(
        "two named sensors in turns",
        lambda k, t, v: f"Sensor 1: {_mm(v)} mm\r\nSensor 2: {_mm(v and v + 20)} mm\r\n",
        "Sensor {module}: {range:mm} mm",
        15,
    ),
    _case(
        "two bare sensors in turns",
        lambda k, t, v: f"{_mm(v)}\r\n{_mm(v and v + 20)}\r\n",
        "millimetres",
        15,
        auto=False,
        message=r"in turns",
        readable=False,
    ),
    _case(
        "three modules, one unplugged",
        lambda k, t, v: (
            f"{_mm(v)} {_mm(v and v + 20)} {_mm(v and v + 40)}\r\n" if t < 2.5 else f"{_mm(v)} {_mm(v and v + 40)}\r\n"
        ),
        "millimetres",
        modules=3,
        auto=False,
        message=r"unplugged|mm, cm or m",
    ),
    _case(
        "JSON, three modules",
        lambda k, t, v: json.dumps({"ms": round(1000 * t), "ranges_mm": [v and round(v), 95, 101]}) + "\n",
        '{{"ms": {time:ms}, "ranges_mm": [{ranges:mm}]}}',
    ),
    _case(
        "JSON without a unit",
        lambda k, t, v: json.dumps({"range": v and round(v), "ok": v is not None}) + "\n",
        '{{"range": {range:mm}, "ok": {status}}}',
        auto=False,
        message=r"do not say their unit",
    ),
    _case(
        "a range that never changes",
        lambda k, t, v: "Distance: 92 mm\r\n",
        "Distance: {range:mm} mm",
        100,
        message=r"92 mm.*times in a row",
        true=lambda k, t: 92.0,
    ),
    _case(
        "boot loop",
        lambda k, t, v: f"{_BOOT}Brownout detector was triggered\r\n",
        "millimetres",
        3,
        auto=False,
        message=r"again and again.*Brownout",
        readable=False,
    ),
    _case(
        "REPL prompt",
        lambda k, t, v: ">>> \r\n" if k == 3 else "",
        "millimetres",
        3,
        auto=False,
        message=r">>>",
        readable=False,
    ),
    _case(
        "no line ends", lambda k, t, v: f"{_mm(v)} ", "millimetres", auto=False, message=r"no line end", readable=False
    ),
    _case(
        "a label, no unit",
        lambda k, t, v: f"Range: {_mm(v)}\r\n",
        "Range: {range:mm}",
        auto=False,
        message=r"do not say",
    ),
    _case(
        "metres, labelled",
        lambda k, t, v: f"distance: {0 if v is None else v / 1000:.3f} m\r\n",
        "distance: {range:m} m",
    ),
    _case(
        "cm, Out of range",
        lambda k, t, v: "Out of range\r\n" if v is None else f"Distance: {v / 10:.2f} cm\r\n",
        "Distance: {range:cm} cm",
        20,
    ),
    _case(
        "inches",
        lambda k, t, v: f"Distance: {0 if v is None else v / 25.4:.2f} in\r\n",
        "Distance: {range:mm}",
        20,
        auto=False,
        message=r"not in mm, cm or m|is not of the format",
        readable=False,
    ),
    _case(
        "range and sigma",
        lambda k, t, v: f"Range: {_mm(v)} mm, sigma: 1.2 mm\r\n",
        "Range: {range:mm} mm, sigma: {any} mm",
        auto=False,
        message=r"Which numbers",
    ),
    _case(
        "raw and filtered",
        lambda k, t, v: f"raw {_mm(v)} mm filtered {_mm(v and v + 3)} mm\r\n",
        "raw {range:mm} mm filtered {any} mm",
        auto=False,
        message=r"Which numbers",
    ),
    _case(
        "temperature besides",
        lambda k, t, v: f"T: {23.5 + k % 3 / 10:.1f} C, D: {_mm(v, 0)} mm\r\n",
        "T: {any} C, D: {range:mm} mm",
    ),
    _case(
        "rows of 8 x 8, blanks",
        lambda k, t, v: _rows(8, "", v),
        "vl53l5cx-rows-8x8",
        10,
        auto=False,
        message=r"bare numbers",
    ),
    _case("SparkFun VL53L5CX 4 x 4", lambda k, t, v: _rows(4, "\t", v), "sparkfun-vl53l5cx-4x4", 30),
    _case(
        "8 x 8, half frames",
        lambda k, t, v: _rows(8, "\t", v)[: 60 if k % 10 == 3 else None],
        "sparkfun-vl53l5cx-8x8",
        10,
    ),
    _case(
        "STM32duino VL53L4CD",
        lambda k, t, v: (
            f"Status = {2 * (v is None):3d}, Distance = {v or 37:5.0f} mm, Signal = {4000:6d} kcps/spad\r\n"
        ),
        "stm32duino-vl53l4cd",
    ),
    _case(
        "a debug line in three",
        lambda k, t, v: ("free heap 201344\r\n" if k % 2 else "") + f"tof: {_mm(v)} mm\r\n",
        "tof: {range:mm} mm",
    ),
    _case(
        "TIMEOUT and 255",
        lambda k, t, v: ("65535 TIMEOUT" if k % 24 == 7 else _mm(v, 255)) + "\r\n",
        "pololu-vl6180x",
        auto=False,
        message=r"bare numbers",
    ),
    _case(
        "only +Inf and nan",
        lambda k, t, v: f"{_mm(v, '+Inf' if k % 24 == 7 else 'nan')}\n",
        "teraranger-evo",
        60,
        auto=False,
        message=r"bare numbers",
    ),
    _case(
        "metres named, millimetres sent",
        lambda k, t, v: f"{_mm(v)}\r\n",
        "metres",
        auto=False,
        message=r"another unit|mm, cm or m",
        readable=False,
    ),
)


def load_cases(folder: Path, named: dict[str, tuple[str, int | None]]) -> list[BoardCase]:
    """The cases of a folder: `index.json` with the times of the writes and the truth, and a file of bytes for each.

    Args:
        named: the format, and perhaps the number of modules, that a user would name for each case.
    """
    cases = []
    for name, entry in json.loads((folder / "index.json").read_text()).items():
        data = (folder / f"{name}.bin").read_bytes()
        starts = [0, *(end for _, end in entry["written"])]
        writes = tuple((float(t), data[start:end]) for start, (t, end) in zip(starts, entry["written"], strict=False))
        truth = tuple((float(t), None if value is None else float(value)) for t, value in entry["true_mm"])
        wire_format, modules = named.get(name, ("millimetres", None))
        cases.append(BoardCase(name, writes, truth, wire_format, modules))
    return cases
