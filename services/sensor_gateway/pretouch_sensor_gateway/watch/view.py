"""The screen: the selected device, and the events of all devices."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime

from rich.console import Console, ConsoleOptions, RenderResult
from rich.text import Text

from pretouch_sensor_gateway.watch.events import Event, Severity
from pretouch_sensor_gateway.watch.module_table import ModuleTable
from pretouch_sensor_gateway.watch.state import Watch, WatchedDevice
from pretouch_sensor_gateway.watch.status_facts import STATE_STYLES, describe_device, describe_operation

_SEVERITY_STYLES = {Severity.GOOD: "green", Severity.NOTE: "", Severity.BAD: "yellow"}
_EVENTS = 8
_LABEL = 10
_LEAST_WIDTH = 10
_LEAST_EVENTS = 2
_LEAST_MODULES = 8
"""Lines that each of these gets first, if it has so many."""


@dataclass(frozen=True)
class View:
    """The whole screen, however large it is.

    Args:
        now: s, of the watch's steady clock.
        wall: Unix time at that moment, s.
        keys: whether the keyboard is read.
    """

    watch: Watch
    now: float
    wall: float
    keys: bool = True

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        height = options.height or console.height
        lines = self._lines(_Layout(console, options.max_width), height - 1)[: height - 1]
        lines += [Text()] * (height - 1 - len(lines))
        yield Text("\n", no_wrap=True, overflow="crop", end="").join([*lines, self._foot()])

    def _lines(self, layout: _Layout, height: int) -> list[Text]:
        """All lines but the last, with as many events and modules as there is room for."""
        device = self.watch.selected
        above, modules, below = list(self._head(layout)), list[Text](), list[Text]()
        if device is not None:
            above += [*layout.facts(describe_device(device, self.now)), layout.rule()]
            modules = list(ModuleTable(device, self.now, self.watch.live(device)).lines(layout.width))
            below = [*[layout.rule()] * bool(modules), *layout.facts(describe_operation(device)), layout.rule()]
        events = [line for event in self.watch.events.last(_EVENTS) for line in self._event(event, layout)]
        room = height - len(above)
        for_modules = max(room - len(below) - min(len(events), _LEAST_EVENTS), min(room, _LEAST_MODULES))
        modules = _fit_lines(modules, for_modules)
        for_events = max(0, room - len(modules) - len(below))
        return [*above, *modules, *below, *events[max(0, len(events) - for_events) :]]

    def _head(self, layout: _Layout) -> Iterator[Text]:
        yield self._title(layout.width)
        if not self.watch.connected:
            yield from layout.wrap(self._outage())
        elif not self.watch.devices:
            yield Text(" The gateway has no device.", "yellow")

    def _title(self, width: int) -> Text:
        """All devices if there is room for them, else the selected one."""
        where = Text(f"gateway {self.watch.address}  {_format_clock(self.wall)} ", "dim")
        room = width - where.cell_len
        names = self._names(self.watch.devices)
        if names.cell_len > room and self.watch.selected is not None:
            names = self._names([self.watch.selected])
            names.append(f"of {len(self.watch.devices)}" if len(self.watch.devices) > 1 else "")
            names.truncate(max(1, room))
        return names.append(" " * (room - names.cell_len)).append_text(where)

    def _names(self, devices: Sequence[WatchedDevice]) -> Text:
        names = Text(" ")
        for device in devices:
            number = f"{self.watch.devices.index(device) + 1} " if len(self.watch.devices) > 1 else ""
            names.append(f" {number}{device.name} ", "bold reverse" if device is self.watch.selected else "")
            names.append("● ", STATE_STYLES[device.status.device.state])
        return names

    def _outage(self) -> Text:
        if not self.watch.problem:
            return Text("Connecting …", "yellow")
        wait = math.ceil(self.watch.retry_at - self.now)
        again = f" Trying again in {wait} s." if wait > 0 else " Trying again …"
        return Text.assemble((self.watch.problem, "bold red"), again)

    def _event(self, event: Event, layout: _Layout) -> Iterator[Text]:
        times = [_format_clock(self.wall - (self.now - at)) for at in (event.at, event.first)]
        device = f"{event.device}: " if event.device and len(self.watch.devices) > 1 else ""
        since = f", since {times[1]}" if event.times > 1 else ""
        return layout.facts([(times[0], Text(f"{device}{event.text}{since}", _SEVERITY_STYLES[event.severity]))])

    def _foot(self) -> Text:
        if not self.keys:
            return Text(" Ctrl-C quits", "dim")
        several = "   1-9, Tab, arrows: another device" if len(self.watch.devices) > 1 else ""
        return Text(f" q quits{several}", "dim")


@dataclass(frozen=True)
class _Layout:
    """Wraps lines to a width."""

    console: Console
    width: int

    def wrap(self, text: Text, label: str = "", indent: int = 1) -> Iterator[Text]:
        """Wraps `text` into indented lines, with `label` before the first one."""
        for line in text.wrap(self.console, max(_LEAST_WIDTH, self.width - indent), overflow="fold"):
            yield Text.assemble((f"{label:{indent}}", "dim"), line)
            label = ""

    def facts(self, facts: Iterable[tuple[str, Text]]) -> Iterator[Text]:
        """Labels with a fact beside each, which may take several lines."""
        for label, fact in facts:
            yield from self.wrap(fact, f" {label} ", _LABEL)

    def rule(self) -> Text:
        return Text("─" * self.width, "dim")


def _fit_lines(lines: list[Text], room: int) -> list[Text]:
    """As many lines as there is room for, with a last one that says how many are not shown."""
    if len(lines) <= room or room < 1:
        return lines[: max(0, room)]
    return [*lines[: room - 1], Text(f" … and {len(lines) - room + 1} more modules", "dim")]


def _format_clock(wall: float) -> str:
    return datetime.fromtimestamp(wall).strftime("%H:%M:%S")
