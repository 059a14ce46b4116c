"""A fingertip on a real pty, with faults of line, power and clock on demand, that records all that it did.

board = Board(tmp_path / "finger")
board.measure(5)                     # five frames; they wait where the line takes no more
board.unplug(); board.plug()         # it keeps its power, and continues to measure and count
board.damage = lambda data: ...      # changes all bytes on the line
"""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pretouch_sensor_gateway.wire_formats.binary import END, FrameDecoder, encode
from pretouch_sensor_gateway.wire_formats.messages import COUNTER_MODULUS, Identify, Message, Ping
from pretouch_sensor_gateway.wire_formats.parser import Identity, Measurement, PingReply

from helpers.links import Pty

FIRST_SERIAL, OTHER_SERIAL = "00000000000000aa", "00000000000000bb"
PAUSE = 0.005
"""Seconds between bursts."""


def whole(data: bytes) -> bytes:
    """A sound line: it changes nothing."""
    return data


class Board:
    """A board; plugged in from the beginning, unless told not to be.

    Args:
        link: the path of its port.
        first_tick: what its clock shows at its start, microseconds.
        sequence: number of its next measurement.
        answers: whether it answers pings.

    Attributes:
        made: measurements so far, sent or not.
        times: by boot number and sequence, when each was measured, s of `time.monotonic`.
        words: every frame that it sent, before the line changed it.
        line: all bytes on the line.
        asked: all bytes that the gateway sent.
        damage: how the line changes bytes.
    """

    def __init__(
        self,
        link: Path,
        *,
        boot: int = 1,
        serial: str = FIRST_SERIAL,
        modules: int = 1,
        first_tick: int = 0,
        sequence: int = 0,
        answers: bool = True,
        plugged: bool = True,
    ) -> None:
        self.boot = boot
        self.made = 0
        self.times: dict[tuple[int, int], float] = {}
        self.words: set[bytes] = set()
        self.line = bytearray()
        self.asked = bytearray()
        self.answers = answers
        self.damage: Callable[[bytes], bytes] = whole
        self._link = link
        self._serial = serial
        self._modules = modules
        self._sequence = sequence
        self._first_tick = first_tick
        self._started = self._stamp = time.monotonic()
        self._decoder = FrameDecoder()
        self._waiting = bytearray()  # for the line
        self._gathers = False
        self._written = asyncio.Event()
        self._pty: Pty | None = None
        if plugged:
            self.plug()

    def plug(self) -> None:
        self._pty = Pty(self._link)
        self._decoder.restart()
        asyncio.get_running_loop().add_reader(self._pty.master, self._hear, self._pty.master)

    def unplug(self) -> None:
        """Unplugs the board; unread bytes are lost."""
        assert self._pty is not None
        pty, self._pty = self._pty, None
        asyncio.get_running_loop().remove_reader(pty.master)
        asyncio.get_running_loop().remove_writer(pty.master)
        self._waiting.clear()
        pty.unplug()

    def reboot(self, first_tick: int) -> None:
        """Loses its power for a moment: another boot number, sequence and clock begin, on the same line."""
        self.boot += 1
        self._sequence, self._first_tick = 0, first_tick
        self._started = self._stamp = time.monotonic()
        self.write(END)
        self._say(self._identity())

    def clock_leaps(self, ticks: int) -> None:
        """Its clock jumps ahead by so many microseconds."""
        self._first_tick += ticks

    def measure(self, count: int = 1, *, heard: bool = True) -> None:
        """As many measurements, evenly over the time since the last one; `heard` tells whether it sends them."""
        before, now = self._stamp, time.monotonic()
        for k in range(1, count + 1):
            frame = self.frame(before + (now - before) * k / count)
            if heard:
                self.write(frame)

    def frame(self, at: float | None = None) -> bytes:
        """The frame of a measurement at host time `at`, s, by default now, for the test to send, or a part of it."""
        self._stamp = time.monotonic() if at is None else at
        self.times[self.boot, self._sequence] = self._stamp
        ranges = tuple(metres(self.boot, self._sequence, k) for k in range(self._modules))
        message = Measurement(self.boot, self._sequence, self._micros(self._stamp), ranges, (0,) * self._modules)
        self._sequence = (self._sequence + 1) % COUNTER_MODULUS
        self.made += 1
        frame = encode(message)
        self.words.add(frame.rstrip(END))
        return frame

    def skip(self, count: int) -> None:
        """Takes measurements that are neither sent nor in `made`; their sequence numbers are used up."""
        self._sequence = (self._sequence + count) % COUNTER_MODULUS

    def write(self, data: bytes) -> None:
        """Writes onto the line, if it is plugged in."""
        if self._pty is None:
            return
        data = self.damage(data)
        self.line += data
        self._waiting += data
        if not self._gathers:
            self._push()

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """All that it writes within the block comes onto the line in one piece, at the end."""
        self._gathers = True
        yield
        self._gathers = False
        self._push()

    async def written(self) -> None:
        """Waits until the line took everything."""
        while self._waiting:
            self._written.clear()
            await self._written.wait()

    async def bursts(self, number: int, frames: int = 5) -> None:
        """Sends so many bursts of some frames each."""
        for _ in range(number):
            self.measure(frames)
            await self.written()
            await asyncio.sleep(PAUSE)

    async def measure_on(self, frames: int = 5) -> None:
        """Sends bursts until cancelled."""
        while True:
            await self.bursts(1, frames)

    def ticks(self) -> list[int]:
        """Its clock at each measurement since the last boot, microseconds."""
        return [self._micros(at) for (boot, _), at in self.times.items() if boot == self.boot]

    @property
    def damaged(self) -> int:
        """The pieces between zeros on the line that are not frames of the board."""
        return sum(piece not in self.words for piece in bytes(self.line).split(END)[:-1] if piece)

    def _hear(self, master: int) -> None:
        with suppress(BlockingIOError):
            data = os.read(master, 4096)
            self.asked += data
            for message in self._decoder.feed(data):
                if isinstance(message, Ping) and self.answers:
                    self._say(PingReply(self.boot, message.sequence, self._micros(time.monotonic())))
                elif isinstance(message, Identify) and self.answers:
                    self._say(self._identity())

    def _identity(self) -> Identity:
        return Identity(self.boot, self._serial, self._modules, 1 / 30, "faulty 1.0")

    def _say(self, message: Message) -> None:
        frame = encode(message)
        self.words.add(frame.rstrip(END))
        self.write(frame)

    def _micros(self, at: float) -> int:
        return (self._first_tick + round((at - self._started) * 1e6)) % COUNTER_MODULUS

    def _push(self) -> None:
        assert self._pty is not None
        loop = asyncio.get_running_loop()
        with suppress(BlockingIOError):
            del self._waiting[: os.write(self._pty.master, self._waiting)]
        if self._waiting:
            loop.add_writer(self._pty.master, self._push)
        else:
            loop.remove_writer(self._pty.master)
            self._written.set()


def metres(boot: int, sequence: int, module: int = 0) -> float:
    """What a board measures: a mixed-up or damaged measurement shows."""
    return ((boot * 7919 + sequence * 7 + module * 101) % 5000 + 1) * 1e-4
