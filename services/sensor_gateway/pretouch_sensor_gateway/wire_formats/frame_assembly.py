"""Puts together what one frame says on several lines: rows of a multizone sensor, or a line for each module."""

from __future__ import annotations

import math
from typing import NamedTuple

from pretouch_sensor_gateway.wire_formats.line_format import LineReading, Misread
from pretouch_sensor_gateway.wire_formats.range_text import NO_ANSWER, Reading


class Frame(NamedTuple):
    """The readings of all modules, and the bytes of their lines."""

    last: LineReading
    readings: tuple[Reading, ...]
    size: int


class RowAssembly:
    """Assembles square frames of `count` rows of as many ranges, with a blank line between two frames.

    A frame is complete with its last row; half a frame is dropped.

    Attributes:
        dropped: rows of frames that were not complete, so far.
    """

    def __init__(self, count: int) -> None:
        self.dropped = 0
        self._count = count
        self._rows: list[tuple[LineReading, int]] = []
        self._between_frames = False

    def add_break(self) -> None:
        """Adds a line that is no row: a frame may begin after it."""
        self.dropped += len(self._rows)
        self._rows.clear()
        self._between_frames = True

    def add(self, row: LineReading, size: int) -> Frame | Misread | None:
        """The frame that `row`, of so many bytes, completes; None if it completes none."""
        if len(row.readings) != self._count:
            self.add_break()
            self._between_frames = False
            return Misread(f"it has {len(row.readings)} ranges, and rows have {self._count}")
        if not self._rows and not self._between_frames:
            return Misread("no blank line shows where a frame begins")
        self._between_frames = False
        self._rows.append((row, size))
        if len(self._rows) < self._count:
            return None
        rows, self._rows = self._rows, []
        readings = tuple(reading for each, _ in rows for reading in each.readings)
        return Frame(row, readings, sum(size for _, size in rows))

    def restart(self) -> None:
        """Forgets a half-received frame: the port was closed."""
        self._rows.clear()
        self._between_frames = False


class ModuleAssembly:
    """Assembles frames of one line for each module, which names it.

    Modules are in the order of their names: numbers by value, then words by the alphabet. The first round of names, or
    as many names as the device has modules, says which there are. A frame is complete with its last module, or when a
    module comes again: those that did not come have no answer.

    Args:
        count: modules that the device has; None: as many as come before one comes again.
    """

    def __init__(self, count: int | None) -> None:
        self._count = count
        self._names: list[str] | None = None
        self._seen: dict[str, tuple[Reading, ...]] = {}

    def add(self, line: LineReading, size: int) -> Frame | Misread | None:
        """The frame that `line`, of so many bytes, completes; None if it completes none."""
        name = line.module or ""
        if self._names is None:
            return self._learn(name, line, size)
        if name not in self._names:
            return Misread(f"module {name!r} is new; the device has {', '.join(self._names)}")
        frame = self._complete(line, size) if name in self._seen else None
        self._seen[name] = line.readings
        return self._complete(line, size) if len(self._seen) == len(self._names) else frame

    def restart(self) -> None:
        """Forgets the modules: another device may be on the port."""
        self._names = None
        self._seen.clear()

    def _learn(self, name: str, line: LineReading, size: int) -> Frame | Misread | None:
        if name in self._seen:
            if self._count is not None:
                names = ", ".join(self._seen)
                self._seen = {name: line.readings}
                return Misread(f"only {names} came, and the device has {self._count} modules: is one unplugged?")
            self._names = sorted(self._seen, key=_order)
            self._seen = {}
            return self.add(line, size)
        self._seen[name] = line.readings
        if len(self._seen) != self._count:
            return None
        self._names = sorted(self._seen, key=_order)
        return self._complete(line, size)

    def _complete(self, line: LineReading, size: int) -> Frame:
        assert self._names is not None
        absent: tuple[Reading, ...] = ((math.nan, NO_ANSWER),) * len(line.readings)
        readings = tuple(reading for name in self._names for reading in self._seen.get(name, absent))
        self._seen = {}
        return Frame(line, readings, size)


def _order(name: str) -> tuple[int, int, str]:
    return (0, int(name), "") if name.isdecimal() else (1, 0, name)
