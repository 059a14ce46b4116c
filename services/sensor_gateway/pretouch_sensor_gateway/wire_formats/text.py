"""Parses devices that print a line of text for every measurement."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

from pretouch_sensor_gateway.wire_formats.line_splitter import LineSplitter
from pretouch_sensor_gateway.wire_formats.messages import MAX_MODULES
from pretouch_sensor_gateway.wire_formats.parser import DeviceMessage, Measurement, Refusal


@dataclass(frozen=True)
class TextFormat:
    """A line-based format.

    Attributes:
        name: as in a configuration.
        read: reads a line of printable ASCII; None if it is not of the format.
        tick_modulus: microseconds at which the device's time wraps; None if it sends none.
    """

    name: str
    read: Callable[[str], Measurement | None]
    tick_modulus: int | None = None


class TextParser:
    """Parses a line-based format (a `Parser`). Nothing is ever sent to such a device.

    Lines have no checksum, so a lost byte can join or cut numbers. A line with another number of modules than those
    before is therefore refused; when a second one has that number before any has the old one, the new number is
    accepted.
    """

    two_way = False

    def __init__(self, text_format: TextFormat) -> None:
        self.name = text_format.name
        self.tick_modulus = text_format.tick_modulus
        self.refused: Counter[Refusal] = Counter()
        self._read = text_format.read
        self._lines = LineSplitter()
        self._modules: int | None = None
        self._candidate_modules: int | None = None

    def feed(self, data: bytes) -> list[DeviceMessage]:
        received: list[DeviceMessage] = []
        for line in self._lines.feed(data):
            outcome = line if isinstance(line, Refusal) else self._measurement(line)
            if isinstance(outcome, Refusal):
                self.refused[outcome] += 1
            else:
                received.append(outcome)
        return received

    def restart(self) -> None:
        self._lines.restart()
        self._modules = self._candidate_modules = None

    def _measurement(self, line: str) -> Measurement | Refusal:
        measurement = self._read(line)
        if measurement is None or not 1 <= len(measurement.ranges) <= MAX_MODULES:
            return Refusal.FIELDS
        modules = len(measurement.ranges)
        if self._modules is None or modules in (self._modules, self._candidate_modules):
            self._modules, self._candidate_modules = modules, None
            return replace(measurement, size=len(line) + 1)
        self._candidate_modules = modules
        return Refusal.FIELDS
