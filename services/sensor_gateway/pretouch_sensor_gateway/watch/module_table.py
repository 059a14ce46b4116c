"""The table of a device's modules."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from rich.text import Text

from pretouch_sensor_gateway.range_batch import Flag
from pretouch_sensor_gateway.watch.gauges import FULL, draw_bar, draw_sparkline
from pretouch_sensor_gateway.watch.state import WatchedDevice
from pretouch_sensor_gateway.watch.status_codes import explain_code
from pretouch_sensor_gateway.watch.trace import SPAN

RECENT = 10.0
"""Seconds over which the share and the rate of returns are computed."""
_WIDE = 112
"""Columns of a terminal from which on there is room for more numbers."""
_DOUBTS = {
    Flag.JUMP: "jump",
    Flag.WARMING_UP: "warming up",
    Flag.BEYOND_CALIBRATION: "beyond calibration",
    Flag.STD_UNKNOWN: "noise unknown",
}
_LEAST_BAR, _LARGEST_BAR = 8, 50
_LEAST_SPARKLINE, _LARGEST_SPARKLINE = 12, 120


@dataclass(frozen=True)
class _Column:
    """A column of `width` characters: its title and each module's cell; right-justified if `number`."""

    title: str
    width: int
    cell: Callable[[int], Text]
    number: bool = False


class ModuleTable:
    """The modules of `device` at time `now`; if not `live`, the ranges are old, and shown dimmed."""

    def __init__(self, device: WatchedDevice, now: float, live: bool) -> None:
        self._device = device
        self._modules = device.status.modules
        self._readings = device.readings
        self._trace = device.trace
        self._now = device.gateway_time(now)
        self._live = live
        self._measurements, self._returns = device.trace.recent(self._now, RECENT)

    def lines(self, width: int) -> Iterator[Text]:
        """The titles, then a line for each module; none if no module is known."""
        columns = self._choose_columns(width)
        if self._readings:
            yield _join_cells([Text(column.title, "dim") for column in columns], columns)
        for k in range(len(self._readings)):
            yield _join_cells([column.cell(k) for column in columns], columns)

    def _choose_columns(self, width: int) -> list[_Column]:
        before = [
            _Column("#", 2, lambda k: Text(str(k)), number=True),
            _Column("mm", 6, self._range, number=True),
            _Column("status", 22, self._status),
        ]
        after = [_Column("returns", 7, self._recent_share, number=True)]
        if width >= _WIDE:
            after.append(_Column("per s", 6, self._rate, number=True))
            after.append(_Column("of all", 6, self._share, number=True))
        after.append(_Column("jumps", 6, self._jumps, number=True))
        room = width - sum(column.width + 1 for column in before + after)
        return before + self._make_gauges(room) + after

    def _make_gauges(self, room: int) -> list[_Column]:
        """Bar and sparkline, or the bar alone, or neither."""
        if room < _LEAST_BAR + 1:
            return []
        with_sparkline = room >= _LEAST_BAR + _LEAST_SPARKLINE + 2
        width = min(max(_LEAST_BAR, 2 * (room - 2) // 5) if with_sparkline else room - 1, _LARGEST_BAR)
        full = f"{1000 * FULL:.0f} mm"
        style = "green" if self._live else "dim"
        gauges = [_Column(f"0{full:>{width - 1}}", width, lambda k: draw_bar(self._readings[k].range, width, style))]
        if with_sparkline:
            gauges.append(self._make_sparkline(min(room - width - 2, _LARGEST_SPARKLINE)))
        return gauges

    def _make_sparkline(self, width: int) -> _Column:
        joined = _count_joined_spans(self._device.status.rate)
        summary = self._trace.latest(self._now, width, joined)
        title = f"last {width * joined * SPAN:.0f} s"
        return _Column(title, width, lambda k: draw_sparkline(summary, k) if k < self._trace.modules else Text())

    def _range(self, k: int) -> Text:
        metres = self._readings[k].range
        if math.isnan(metres):
            return Text("-", "dim")
        return Text(f"{1000 * metres:.1f}", "bold" if self._live else "dim")

    def _status(self, k: int) -> Text:
        reading = self._readings[k]
        words = explain_code(reading.code, self._device.status.format)
        doubts = "".join(f", {text}" for flag, text in _DOUBTS.items() if reading.flags & flag)
        good = reading.code == 0
        style = "green" if good and not doubts else "yellow"
        return Text(f"{words}{doubts}" if good else f"{reading.code} {words}{doubts}", style if self._live else "dim")

    def _recent_share(self, k: int) -> Text:
        return _format_percent(int(self._returns[k]) if k < len(self._returns) else 0, self._measurements)

    def _share(self, k: int) -> Text:
        """Since the gateway started."""
        if k >= len(self._modules):
            return _format_percent(0, 0)
        return _format_percent(self._modules[k].returns, self._modules[k].measurements)

    def _rate(self, k: int) -> Text:
        """Returns a second."""
        if not self._live or not self._measurements:
            return Text("-", "dim")
        return Text(f"{self._device.status.rate * int(self._returns[k]) / self._measurements:.1f}")

    def _jumps(self, k: int) -> Text:
        jumps = self._modules[k].jumps if k < len(self._modules) else 0
        return Text(f"{jumps:,}", "" if jumps else "dim")


def _join_cells(cells: list[Text], columns: list[_Column]) -> Text:
    line = Text(no_wrap=True, overflow="crop")
    for cell, column in zip(cells, columns, strict=True):
        cell.truncate(column.width)
        blank = " " * (column.width - cell.cell_len)
        line.append(" " + blank if column.number else " ").append_text(cell).append("" if column.number else blank)
    return line


def _count_joined_spans(rate: float) -> int:
    """Spans of the trace for one character, so that a slow device has a measurement or two in each."""
    return 1 if rate <= 0 else min(max(1, math.ceil(2 / (rate * SPAN))), 8)


def _format_percent(part: int, whole: int) -> Text:
    return Text(f"{100 * part / whole:.0f} %" if whole else "-", "" if whole else "dim")
