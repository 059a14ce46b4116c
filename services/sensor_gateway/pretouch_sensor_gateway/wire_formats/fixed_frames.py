"""Binary frames of a fixed length with a checksum, as range finders of other makers send them."""

from __future__ import annotations

from collections import Counter
from typing import Protocol

from pretouch_sensor_gateway.wire_formats.parser import OK, DeviceMessage, Measurement, Refusal

_ESTABLISHED = 4
"""Frames without a gap that nothing else sends by chance: their headers and checksums are 8 bytes or more."""


class FrameKind(Protocol):
    """One maker's frame."""

    @property
    def name(self) -> str:
        """Of the wire format."""
        ...

    @property
    def unit(self) -> str:
        """Of its ranges."""
        ...

    @property
    def header(self) -> bytes:
        """The bytes that every frame starts with."""
        ...

    @property
    def length(self) -> int:
        """Bytes of a frame."""
        ...

    def is_sound(self, frame: bytes) -> bool:
        """Whether the checksum is right."""
        ...

    def read(self, frame: bytes) -> Measurement | str:
        """The measurement in a frame whose checksum is right, or why it cannot be believed."""
        ...


class FixedFrameParser:
    """Parses frames of one kind (a `Parser`). Nothing is ever sent to such a device.

    Bytes between two frames are skipped, and count as one refusal. Two frames in a row must be sound before the first
    is
    believed: a short checksum is right by chance too often.

    Attributes:
        consecutive: sound frames that came without a gap.
        established: whether so many came without a gap, a range among them and none that cannot be believed, that
            nothing
            else sends such bytes.
        problem: why the last sound frame cannot be believed; "" if it can.
    """

    two_way = False
    tick_modulus = None

    def __init__(self, kind: FrameKind) -> None:
        self.name = kind.name
        self.unit = kind.unit
        self.problem = ""
        self.refused: Counter[Refusal] = Counter()
        self.consecutive = self._ranges = self._incredible = 0  # since the last gap
        self.established = False
        self.kind = kind
        self._buffer = bytearray()
        self._in_gap = False

    def feed(self, data: bytes) -> list[DeviceMessage]:
        self._buffer += data
        received: list[DeviceMessage] = []
        kind, at = self.kind, 0
        while len(self._buffer) - at >= kind.length:
            frame = bytes(self._buffer[at : at + kind.length])
            if frame.startswith(kind.header) and kind.is_sound(frame):
                at += kind.length
                self.consecutive += 1
                self._in_gap = False
                outcome = kind.read(frame)
                self.problem = outcome if isinstance(outcome, str) else ""
                self._count(outcome)
                if isinstance(outcome, Measurement) and self.consecutive > 1:
                    received.append(outcome)
                else:
                    self.refused[Refusal.FIELDS] += 1
                continue
            self._skip()
            following = self._buffer.find(kind.header[:1], at + 1)
            at = following if following >= 0 else len(self._buffer)
        del self._buffer[:at]
        return received

    def restart(self) -> None:
        self._buffer.clear()
        self.consecutive = self._ranges = self._incredible = 0
        self.established, self._in_gap, self.problem = False, False, ""

    def _count(self, outcome: Measurement | str) -> None:
        if isinstance(outcome, str):
            self._incredible += 1
        else:
            self._ranges += outcome.status[0] == OK
        self.established |= self.consecutive >= _ESTABLISHED and self._ranges > 0 and not self._incredible

    def _skip(self) -> None:
        self.consecutive = self._ranges = self._incredible = 0
        if not self._in_gap:
            self.refused[Refusal.CHECKSUM] += 1
        self._in_gap = True
