"""What a source of batches is, a device on a port or a recording, and the status that it reports."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

from pretouch_sensor_gateway.calibration.model import Calibration
from pretouch_sensor_gateway.wire_formats.parser import Identity, Refusal


class DeviceState(Enum):
    """The state of a device's connection."""

    CONNECTING = "opening the port, or waiting to try again"
    STREAMING = "frames arrive"
    SILENT = "the port is open but no good frame has come for a while"
    ENDED = "a recording was played to its end"


@dataclass(frozen=True)
class ClockState:
    """How a device's clock compares to the host's.

    Attributes:
        synchronised: whether its time is known.
        drift: s/s by which it runs fast, 0 while unknown.
        std: one standard deviation of a measurement's time, s; NaN while unknown.
        round_trip: shortest round trip of the recent pings, s; 0 if there are none.
        host_jumps: how often the host's own clock was seen to jump.
        latency: s that were subtracted for the time from a measurement to its line: as configured, or assumed.
    """

    synchronised: bool = False
    drift: float = 0.0
    std: float = float("nan")
    round_trip: float = 0.0
    host_jumps: int = 0
    latency: float = 0.0


@dataclass(frozen=True)
class SourceStatus:
    """The status of a source. Counts are since the gateway started.

    Attributes:
        problem: what is wrong, "" if nothing is.
        format: the wire format in use, "" while it is not recognised.
        unit: in which the device sends ranges, "" while that is not known.
        recent_lines: what it sent last, in quotes and escaped, or in hexadecimal where it is no text.
        epoch: number of the boot session: how often the device was seen to restart.
        connections: how often the port was opened.
        measurements: delivered in batches.
        refused: frames or lines, by reason.
        lost: measurements missing by sequence number.
        untimed: good measurements given up because the device's time was not known.
    """

    state: DeviceState
    problem: str = ""
    format: str = ""
    unit: str = ""
    recent_lines: tuple[str, ...] = ()
    identity: Identity | None = None
    epoch: int = 0
    connections: int = 0
    measurements: int = 0
    refused: Counter[Refusal] = field(default_factory=Counter)
    lost: int = 0
    untimed: int = 0
    clock: ClockState = ClockState()


class Source(Protocol):
    """Delivers a device's batches."""

    async def run(self) -> None:
        """Delivers batches until cancelled, or until the recording ends."""
        ...

    def status(self) -> SourceStatus: ...

    def now(self) -> float:
        """The present, Unix time, s: of a recording, when its last batch was measured."""
        ...

    def calibrate(self, calibration: Calibration | None) -> None:
        """Calibrates ranges by `calibration` from now on; None: takes them as the device reports them."""
        ...
