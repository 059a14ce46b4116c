"""A simulated fingertip without any port: what it sends, and when, in simulated time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pretouch_sensor_gateway.wire_formats.binary import FrameDecoder, encode
from pretouch_sensor_gateway.wire_formats.messages import COUNTER_MODULUS, Identify, Ping
from pretouch_sensor_gateway.wire_formats.parser import Identity, Measurement, PingReply


class VirtualFinger:
    """A board that measures at a steady rate by a clock of its own. Times are simulated host seconds.

    Args:
        boot: its boot number.
        start: host time at which it starts.
        first_tick: what its clock shows then, microseconds.
        drift: s/s by which its clock is fast.

    Attributes:
        start: as told.
        sent: measurements made so far.
    """

    def __init__(
        self,
        boot: int = 1,
        start: float = 0.0,
        *,
        modules: int = 6,
        rate: float = 30.0,
        first_tick: int = 0,
        drift: float = 20e-6,
        serial: str = "00000000000000aa",
    ) -> None:
        self.boot = boot
        self.modules = modules
        self.sent = 0
        self.start = start
        self._rate = rate
        self._first_tick = first_tick
        self._drift = drift
        self._serial = serial
        self._paused = 0.0
        self._decoder = FrameDecoder()

    @property
    def next_due(self) -> float:
        """Host time of the next measurement."""
        return float(self.time_of(self.sent))

    def time_of(self, sequence: float | NDArray[np.float64]) -> Any:
        """Host time of measurements by number, after the last pause."""
        return self.start + self._paused + (sequence + 1) / self._rate

    def pause(self, seconds: float) -> None:
        """Measures nothing for so long; the clock goes on."""
        self._paused += seconds

    def skip_to(self, now: float) -> None:
        """Skips the measurements until `now`: they were made, but not read."""
        while self.next_due <= now:
            self.sent += 1

    def micros(self, now: float) -> int:
        """Its clock at host time `now`."""
        return (self._first_tick + round((now - self.start) * 1e6 * (1 + self._drift))) % COUNTER_MODULUS

    def measure(self, metres: float | None = None) -> bytes:
        """The frame of the next measurement; by default a slow wave, 2 to 6 cm, a little different for each module."""
        at = self.next_due
        ranges = tuple(
            metres if metres is not None else 0.04 + 0.02 * math.sin(0.5 * at + 0.3 * k) for k in range(self.modules)
        )
        frame = encode(
            Measurement(self.boot, self.sent % COUNTER_MODULUS, self.micros(at), ranges, (0,) * self.modules)
        )
        self.sent += 1
        return frame

    def answers(self, data: bytes, now: float) -> bytes:
        """The replies to the requests in `data`."""
        replies = []
        for message in self._decoder.feed(data):
            if isinstance(message, Ping):
                replies.append(encode(PingReply(self.boot, message.sequence, self.micros(now))))
            elif isinstance(message, Identify):
                replies.append(encode(Identity(self.boot, self._serial, self.modules, 1 / self._rate, "virtual 1.0")))
        return b"".join(replies)


def flip_bits(data: bytes, share: float, rng: np.random.Generator) -> bytes:
    """`data` with each bit flipped with probability `share`."""
    bits = np.unpackbits(np.frombuffer(data, dtype=np.uint8))
    return np.packbits(bits ^ (rng.random(len(bits)) < share)).tobytes()
