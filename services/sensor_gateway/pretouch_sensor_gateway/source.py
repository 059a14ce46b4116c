"""Where a device's batches come from: a port, or a recording. What is known of it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

from pretouch_sensor_gateway.calibration.model import Calibration
from pretouch_sensor_gateway.wire_formats.received import Identity, Refusal


class DeviceState(Enum):
    """How a device's connection fares."""

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
        std: one standard deviation of a frame's time, s; NaN while unknown.
        round_trip: least round trip of the recent pings, s; 0 if there are none.
        host_jumps: how often the host's own clock was seen to jump.
    """

    synchronised: bool = False
    drift: float = 0.0
    std: float = float("nan")
    round_trip: float = 0.0
    host_jumps: int = 0


@dataclass(frozen=True)
class SourceStatus:
    """How a source fares. Counts are since the gateway started; every good frame is delivered, or one of the losses.

    Attributes:
        problem: what is wrong, "" if nothing is.
        format: the wire format in use, "" while it is not recognised.
        epoch: how often the device was seen to start anew.
        connections: how often the port was opened.
        frames: good ones.
        refused: by reason.
        lost: missing by sequence number.
        untimed: good ones given up because the device's time was not known.
    """

    state: DeviceState
    problem: str = ""
    format: str = ""
    identity: Identity | None = None
    epoch: int = 0
    connections: int = 0
    frames: int = 0
    refused: Counter[Refusal] = field(default_factory=Counter)
    lost: int = 0
    untimed: int = 0
    clock: ClockState = ClockState()


class Source(Protocol):
    """Gives batches to whom it was told to, until cancelled or ended."""

    async def run(self) -> None: ...

    def status(self) -> SourceStatus: ...

    def now(self) -> float:
        """The present, s since the Unix epoch: of a recording, when its last batch was measured."""
        ...

    def calibrate(self, calibration: Calibration | None) -> None:
        """Takes ranges by this calibration from now on; None: as the device tells them."""
        ...
