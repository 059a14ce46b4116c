"""One finger: its port, its clock, and everyone who listens to it."""

from __future__ import annotations

import asyncio
import random
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum

import structlog

from pretouch_sensor_gateway.clock import DeviceClock, signed_difference
from pretouch_sensor_gateway.framing import Decoder, encode
from pretouch_sensor_gateway.history import History
from pretouch_sensor_gateway.messages import COUNTER_MODULUS, Ping, PingReply, Ranges
from pretouch_sensor_gateway.subscription import Subscription, TimedFrame
from pretouch_sensor_gateway.transport import Link, LinkState

SILENT_AFTER = 1.0
"""Seconds without a good frame after which an open port counts as silent."""
PING_INTERVAL = 1.0
FIRST_PING_INTERVAL = 0.05
FIRST_PINGS = 8
"""After a start the clock is sought quickly: this many pings at the shorter interval, s."""
_PING_LIFETIME = 2.0
_MAX_HELD = 256
"""Frames held until the first ping is answered; it takes milliseconds, so more means that none ever is."""


class DeviceState(Enum):
    """How a device's connection fares."""

    CONNECTING = "opening the port, or waiting to try again"
    STREAMING = "frames arrive"
    SILENT = "the port is open but no good frame has come for a while"


@dataclass(frozen=True)
class DeviceStatus:
    """How a device fares. Counts are since the gateway started; `problem` says what is wrong, "" if nothing is."""

    state: DeviceState
    frames: int
    bad_frames: int
    lost_frames: int
    problem: str


class Device:
    """A finger on a serial port.

    Attributes:
        name: what requests call it.
        history: its last minutes.
    """

    def __init__(self, name: str, port: str, log: structlog.typing.FilteringBoundLogger) -> None:
        self.name = name
        self.history = History()
        self._log = log.bind(device=name)
        self._link = Link(port, self, self._log)
        self._decoder = Decoder()
        self._clock = DeviceClock()
        self._subscriptions: set[Subscription] = set()
        self._sequence: int | None = None
        self._frames = self._lost = 0
        self._held: deque[tuple[Ranges, float]] = deque()
        self._pings: dict[int, float] = {}
        self._next_ping = random.getrandbits(32)
        self._quick_pings = 0
        self._ping_now = asyncio.Event()
        self._opened_at = self._last_good = -float("inf")

    @property
    def port(self) -> str:
        return self._link.url

    async def run(self) -> None:
        """Reads the port, and asks for the device's time, until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._link.run())
            tasks.create_task(self._ping_forever())

    @contextmanager
    def subscribed(self) -> Iterator[Subscription]:
        """A subscription to all frames from now on, for as long as the block lasts."""
        subscription = Subscription()
        self._subscriptions.add(subscription)
        try:
            yield subscription
        finally:
            self._subscriptions.discard(subscription)

    def wake(self) -> None:
        """Lets every listener look up, though there may be nothing new."""
        for subscription in self._subscriptions:
            subscription.changed.set()

    def status(self) -> DeviceStatus:
        now = time.monotonic()
        return DeviceStatus(
            state=self._state(now),
            frames=self._frames,
            bad_frames=self._decoder.refused.total(),
            lost_frames=self._lost,
            problem=self._problem(now),
        )

    def opened(self) -> None:
        """The port is open: half a frame and unanswered pings of before are void."""
        self._opened_at = time.monotonic()
        self._decoder.restart()
        self._seek_clock()

    def received(self, data: bytes, at: float) -> None:
        """Bytes of the device, and the `time.monotonic()` at which they were read."""
        for message in self._decoder.feed(data):
            if isinstance(message, Ranges):
                self._last_good = at
                self._frames += 1
                self._measured(message, at)
            elif isinstance(message, PingReply):
                self._answered(message, at)

    def _measured(self, message: Ranges, at: float) -> None:
        step = 1 if self._sequence is None else signed_difference(message.sequence, self._sequence)
        if step <= 0 or not self._clock.follows(message.micros, at):
            self._restarted()
        self._sequence = message.sequence
        if step > 1:
            self._miss(step - 1)
        device_time = self._clock.unwrap(message.micros, at)
        if self._clock.synchronised:
            self._deliver(message, device_time)
            return
        if len(self._held) == _MAX_HELD:
            self._held.popleft()
            self._miss(1)
        self._held.append((message, device_time))

    def _answered(self, message: PingReply, at: float) -> None:
        sent = self._pings.pop(message.sequence, None)
        if sent is None:
            return
        if not self._clock.follows(message.micros, at):
            self._restarted()
        self._clock.answered(sent, at, self._clock.unwrap(message.micros, at))
        while self._held:
            self._deliver(*self._held.popleft())

    def _restarted(self) -> None:
        self._log.info("the device started anew")
        self._clock.restart()
        self._sequence = None
        if self._held:
            self._miss(len(self._held))
            self._held.clear()
        self._seek_clock()

    def _deliver(self, message: Ranges, device_time: float) -> None:
        host_time = self._clock.host_time(device_time)
        assert host_time is not None
        t = host_time + (time.time() - time.monotonic())
        frame = TimedFrame(message.sequence, t, message.ranges, message.status)
        self.history.add(frame)
        for subscription in self._subscriptions:
            subscription.offer(frame)

    def _miss(self, count: int) -> None:
        self._lost += count
        for subscription in self._subscriptions:
            subscription.miss(count)

    def _seek_clock(self) -> None:
        self._pings.clear()
        self._quick_pings = FIRST_PINGS
        self._ping_now.set()

    async def _ping_forever(self) -> None:
        while True:
            self._ping_now.clear()
            if self._link.state is LinkState.OPEN:
                await self._ping()
            self._quick_pings = max(0, self._quick_pings - 1)
            try:
                async with asyncio.timeout(FIRST_PING_INTERVAL if self._quick_pings else PING_INTERVAL):
                    await self._ping_now.wait()
            except TimeoutError:
                continue

    async def _ping(self) -> None:
        now = time.monotonic()
        self._pings = {number: sent for number, sent in self._pings.items() if now - sent < _PING_LIFETIME}
        self._next_ping = (self._next_ping + 1) % COUNTER_MODULUS
        self._pings[self._next_ping] = now
        await self._link.write(encode(Ping(self._next_ping)))

    def _state(self, now: float) -> DeviceState:
        if self._link.state is not LinkState.OPEN:
            return DeviceState.CONNECTING
        if now - self._last_good <= SILENT_AFTER:
            return DeviceState.STREAMING
        return DeviceState.CONNECTING if now - self._opened_at <= SILENT_AFTER else DeviceState.SILENT

    def _problem(self, now: float) -> str:
        if self._link.state is not LinkState.OPEN:
            return self._link.problem
        if now - max(self._last_good, self._opened_at) > SILENT_AFTER:
            refused = self._decoder.refused.most_common(1)
            if not refused:
                return "The port is open but nothing comes that ends a frame."
            return f"The port is open but no good frame comes; most were refused because: {refused[0][0].value}."
        if not self._clock.synchronised and now - self._opened_at > SILENT_AFTER:
            return "The device answers no pings, so its frames have no time and are not passed on."
        return ""
