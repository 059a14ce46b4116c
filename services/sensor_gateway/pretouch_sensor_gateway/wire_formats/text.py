"""Parses devices that print lines of text."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass

from pretouch_sensor_gateway.wire_formats.frame_assembly import Frame, ModuleAssembly, RowAssembly
from pretouch_sensor_gateway.wire_formats.line_checks import TimeCheck, TurnsCheck
from pretouch_sensor_gateway.wire_formats.line_format import LineFormat, LineReading, Misread
from pretouch_sensor_gateway.wire_formats.line_splitter import LineSplitter
from pretouch_sensor_gateway.wire_formats.messages import MAX_MODULES
from pretouch_sensor_gateway.wire_formats.parser import OK, DeviceMessage, Measurement, Refusal
from pretouch_sensor_gateway.wire_formats.pattern import TIME_UNITS
from pretouch_sensor_gateway.wire_formats.quoting import quote
from pretouch_sensor_gateway.wire_formats.range_text import METRES

_REMEMBERED = 20
"""Measurements after which the reason why a line was refused is no longer a problem."""
_NEVER_GOOD = 40
"""Lines in a row with a range whose status is not good before the meaning of the status is doubted."""
_DIGIT_COMMA_DIGIT = re.compile(r"(?<=\d),(?=\d)")


@dataclass(frozen=True)
class Modules:
    """What is known beforehand of a device's modules.

    Attributes:
        count: how many it has; None: as many as its first lines say.
        range_per_reading: by what each module's reading is multiplied to be the range along its beam; empty: 1 for all.
    """

    count: int | None = None
    range_per_reading: tuple[float, ...] = ()


class TextParser:
    """Parses a line-based format (a `Parser`). Nothing is ever sent to such a device.

    Lines have no checksum, so a lost byte can join or cut numbers, and a module that falls out can shift the others: a
    line with another number of ranges than the device has modules is refused. Where the number is not stated the first
    lines say it: the first that two consecutive lines agree on stays.
    """

    two_way = False

    def __init__(self, line_format: LineFormat, modules: Modules | None = None) -> None:
        self.name = line_format.name
        self.unit = line_format.unit
        self.tick_modulus = line_format.tick_modulus
        self.refused: Counter[Refusal] = Counter()
        self._format = line_format
        self._modules = modules or Modules()
        self._lines = LineSplitter()
        self._count: int | None = None  # learned of the lines
        self._count_is_certain = False
        self._rows = RowAssembly(line_format.rows) if line_format.rows > 1 else None
        self._named = ModuleAssembly(self._modules.count) if line_format.names_modules else None
        self._turns = TurnsCheck(METRES[self.unit])
        self._time = None if self.tick_modulus is None else TimeCheck(self.tick_modulus)
        self._reason = ""
        self._since_reason = 0
        self._never_good = 0

    @property
    def problem(self) -> str:
        """Why lines of this format were refused lately; "" if none was."""
        return self._reason

    def feed(self, data: bytes) -> list[DeviceMessage]:
        received: list[DeviceMessage] = []
        for line in self._lines.feed(data):
            outcome = self._handle(line)
            if isinstance(outcome, Refusal):
                self.refused[outcome] += 1
            elif outcome is not None:
                received.append(outcome)
        if self._rows is not None and self._rows.dropped:
            self.refused[Refusal.FIELDS] += self._rows.dropped
            self._rows.dropped = 0
        return received

    def restart(self) -> None:
        self._lines.restart()
        self._count, self._count_is_certain = None, False
        self._turns = TurnsCheck(METRES[self.unit])
        self._time = None if self.tick_modulus is None else TimeCheck(self.tick_modulus)
        for assembly in (self._rows, self._named):
            if assembly is not None:
                assembly.restart()
        self._reason, self._since_reason, self._never_good = "", 0, 0

    def _handle(self, line: str | Refusal) -> Measurement | Refusal | None:
        reading = None if isinstance(line, Refusal) or not line else self._format.read(line)
        if self._rows is not None and not isinstance(reading, LineReading):
            self._rows.add_break()
        if isinstance(line, Refusal) or not line:
            return line or None
        if reading is None:
            return None if self._format.skips(line) else Refusal.FIELDS
        if isinstance(reading, Misread):
            return self._refuse(line, reading.reason)
        frame = self._assemble(reading, len(line) + 1)
        if isinstance(frame, Misread):
            return self._refuse(line, frame.reason)
        if frame is None:
            return None
        doubt = self._doubt(line, frame)
        if doubt:
            return self._refuse(line, doubt)
        self._since_reason += 1
        if self._since_reason >= _REMEMBERED:
            self._reason = self._status_doubt(line)
        return self._measurement(frame)

    def _assemble(self, reading: LineReading, size: int) -> Frame | Misread | None:
        if self._rows is not None:
            return self._rows.add(reading, size)
        if self._named is not None:
            return self._named.add(reading, size)
        return Frame(reading, reading.readings, size)

    def _refuse(self, line: str, reason: str) -> Refusal:
        self._reason = f"The line {quote(line)} is refused: {reason}{'' if reason.endswith('?') else '.'}"
        self._since_reason = 0
        return Refusal.FIELDS

    def _doubt(self, line: str, frame: Frame) -> str:
        """Why a frame cannot be believed; "" if it can."""
        unit = self.unit
        if "," in line and self._commas_are_unclear(line, len(frame.readings)):
            return (
                f'its comma may be a decimal comma, or part two numbers. Set format = "{{range:{unit},}}" for one '
                f'range with a decimal comma, "{{range:{unit}}},{{range:{unit}}}" for two modules, or '
                f'"{{range:{unit}}},{{status}}" for a range and its status'
            )
        count = self._modules.count or self._count
        if not self._agrees(len(frame.readings)):
            stated = "" if self._modules.count is None else " in the configuration"
            return (
                f"it has {len(frame.readings)} {_plural('range', len(frame.readings))}, and the device has {count} "
                f"{_plural('module', count)}{stated}: is one unplugged, or a column no range? Which is missing the "
                "line does not say"
            )
        micros = frame.last.micros
        step = None if self._time is None or micros is None else self._time.add(micros)
        if step is not None:
            return self._time_doubt(step)
        if len(frame.readings) == 1 and self._named is None:
            self._turns.add(frame.readings[0][0], frame.last.text)
        if self._turns.detected:
            return (
                "the ranges of every second, third or fourth line belong together, so several sensors print in turns "
                "and nothing says which is which. Print all on one line, or a name before each range and set format = "
                f'"{{module}}: {{range:{unit}}}"'
            )
        return ""

    def _time_doubt(self, step: float) -> str:
        if not step:
            return "its time stands still from line to line: print it finer, or skip it with {any}"
        unit = self._format.time_unit or ""
        return (
            f"its time goes on by {step / TIME_UNITS[unit]:.6g} {unit.replace('hms', 's')} from line to line, which no "
            "sensor does: is it in another unit, s, ms or us, or no time?"
        )

    def _commas_are_unclear(self, line: str, ranges: int) -> bool:
        """Whether a comma may be a decimal comma, or a separator."""
        if not self._format.takes_list or self._format.decimal_comma:
            return False
        commas = line.count(",")
        if not commas or "." in line or len(_DIGIT_COMMA_DIGIT.findall(line)) < commas:
            return False
        if re.search(r"[; \t]", line.strip()):
            return True
        expected = self._modules.count or (self._count if self._count_is_certain else None)
        return commas == 1 and self._time is None and expected != ranges

    def _agrees(self, ranges: int) -> bool:
        if ranges > MAX_MODULES:
            return False
        if self._modules.count is not None:
            return ranges == self._modules.count
        if self._count_is_certain or self._count in (None, ranges):
            self._count_is_certain |= self._count == ranges
            self._count = self._count or ranges
            return self._count == ranges
        self._count = ranges
        return False

    def _status_doubt(self, line: str) -> str:
        if self._never_good < _NEVER_GOOD:
            return ""
        return (
            f"No status was good on the last {self._never_good} lines, as on {quote(line)}. If that status is good, "
            "name it in the format: {status:5|9}."
        )

    def _measurement(self, frame: Frame) -> Measurement:
        ranges, status = zip(*frame.readings, strict=True)
        self._never_good = 0 if OK in status or not self._format.has_status else self._never_good + 1
        factors = self._modules.range_per_reading
        if len(factors) == len(ranges):
            ranges = tuple(metres * factor for metres, factor in zip(ranges, factors, strict=True))
        return Measurement(None, frame.last.sequence, frame.last.micros, ranges, status, frame.size)


def _plural(noun: str, count: int | None) -> str:
    return noun if count == 1 else f"{noun}s"
