"""What a parser makes of a device's bytes, whatever the wire format: messages, and reasons to refuse something."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

OK = 0
"""Status of a good range."""


@dataclass(frozen=True)
class Measurement:
    """One measurement of every module of a device.

    Attributes:
        boot: a number that changes with every boot of the device; None if its format has none.
        sequence: counts measurements from 0 at boot; 32 bits, wraps; None if its format has none.
        micros: device clock at the measurement, microseconds, wraps at the format's modulus; None if it has none.
        ranges: m along the beam of each module, NaN where it has none.
        status: each module's own status code, 0 is good.
        size: bytes of its line on the wire, up to the one that ended it; 0 where its time does not depend on that.
    """

    boot: int | None
    sequence: int | None
    micros: int | None
    ranges: tuple[float, ...]
    status: tuple[int, ...]
    size: int = 0


@dataclass(frozen=True)
class PingReply:
    """The reply to the ping of that `sequence`; `micros` is the device clock when it was sent."""

    boot: int
    sequence: int
    micros: int


@dataclass(frozen=True)
class Identity:
    """What a device reports of itself.

    Attributes:
        boot: as in its measurements.
        serial: unique to the board, hexadecimal, "" if it has none.
        modules: how many it has.
        period: s between two measurements.
        firmware: name and version.
    """

    boot: int
    serial: str
    modules: int
    period: float
    firmware: str


DeviceMessage = Measurement | PingReply | Identity


class Refusal(Enum):
    """Why something that a device sent was refused; the value is the text for users."""

    OVERSIZE = "longer than any frame or line may be"
    ENCODING = "not in the encoding of the format"
    CHECKSUM = "checksum does not match"
    VERSION = "another version of the format"
    KIND = "a kind of message that this version does not have"
    LENGTH = "length does not fit the kind of message"
    FIELDS = "a line whose fields the format does not have"
    IMPLAUSIBLE = "does not follow what came before, and nothing that came after confirmed it"
    FOREIGN = "from a board other than the one configured"


class Parser(Protocol):
    """Parses a device's bytes, in pieces of any size, into messages, and counts what it refuses.

    Attributes:
        name: of the wire format, as in a configuration.
        two_way: whether the device answers pings and identifies itself; otherwise nothing is ever sent to it.
        tick_modulus: microseconds at which the device's time wraps; None if it sends none.
        unit: of its ranges: mm, cm or m; "" while the format is not known.
        problem: why well-formed frames or lines were refused lately; "" if none was.
        refused: frames or lines refused so far, by reason.
    """

    @property
    def name(self) -> str: ...
    @property
    def unit(self) -> str: ...
    @property
    def problem(self) -> str: ...
    @property
    def two_way(self) -> bool: ...
    @property
    def tick_modulus(self) -> int | None: ...
    @property
    def refused(self) -> Counter[Refusal]: ...

    def feed(self, data: bytes) -> list[DeviceMessage]:
        """The messages that `data` completes, in their order; never raises."""
        ...

    def restart(self) -> None:
        """Forgets a half-received message: the port was closed."""
        ...
