"""Keeps a port open: reads it on the event loop, and reopens it after every outage.

    OPENING ──▶ OPEN ──(lost)──▶ WAITING ──(backoff)──▶ OPENING ...
       └──────────(failed)──────────▲

Only opening and closing may block, and each runs in its own thread. Reading waits in the event loop's selector, so that
many ports need no threads; the time of a read is late if the loop is busy.
"""

from __future__ import annotations

import asyncio
import os
import time
from contextlib import suppress
from enum import Enum
from functools import partial
from typing import Protocol

import structlog

from pretouch.backoff import Backoff
from pretouch_sensor_gateway.transport.address import DEFAULT_BAUD, parse_address
from pretouch_sensor_gateway.transport.port import Port, close_port, open_port
from pretouch_sensor_gateway.transport.problem import describe_loss
from pretouch_sensor_gateway.transport.threads import DaemonThreads

FIRST_DELAY = 0.1
"""Seconds before a port is reopened; doubles with every further try until bytes were read."""
MAX_DELAY = 5.0
STEADY_AFTER = 10.0
"""Seconds for which a port must stay open, and still send, before its outage is logged as over."""
MAX_READ = 4096
"""Bytes read at a time, so that a device that sends without pause does not block the others."""
_SLOW = 5.0
"""Seconds after which opening or closing is reported as a problem."""
_PATIENCE = 1.0
"""Seconds that a cancelled link waits for its threads; one that still hangs is abandoned and closes its
port itself."""


class LinkState(Enum):
    """The state of a port."""

    OPENING = "opening"
    OPEN = "open"
    WAITING = "waiting to open again"


class Listener(Protocol):
    """Gets a link's events on the event loop; `at` is `time.monotonic()`. An exception that it raises ends the link."""

    def on_opened(self, at: float) -> None:
        """The port is open."""
        ...

    def on_received(self, data: bytes, at: float) -> None:
        """Bytes, at least one, were read at this time."""
        ...

    def on_closed(self, at: float) -> None:
        """The open port was lost: a half-received message is void, and nothing more comes before it is reopened."""
        ...


class Link:
    """One port and its connection.

    Attributes:
        address: as it was given.
        state: of the port.
        problem: why it is not open, "" when it is.
        connections: how often it was opened.
        unsent: bytes given to `write` that the port did not take.

    Raises:
        InvalidInput: the address is not valid.
    """

    def __init__(
        self, address: str, listener: Listener, log: structlog.typing.FilteringBoundLogger, baud: int = DEFAULT_BAUD
    ) -> None:
        self.address = address
        self.state = LinkState.OPENING
        self.problem = ""
        self.connections = 0
        self.unsent = 0
        self._target = parse_address(address)
        self._baud = baud
        self._listener = listener
        self._log = log
        self._threads = DaemonThreads(f"port {address}")
        self._fd: int | None = None
        self._opened_at = 0.0
        self._data_received = False  # since the port was opened
        self._outage_since: float | None = None

    async def run(self) -> None:
        """Keeps the port open until cancelled, then closes it."""
        backoff = Backoff(FIRST_DELAY, MAX_DELAY)
        try:
            while True:
                await self._connect_once()
                if self._data_received:
                    backoff.reset()
                await asyncio.sleep(backoff.next_delay())
        finally:
            with suppress(TimeoutError):
                async with asyncio.timeout(_PATIENCE):
                    await self._threads.join()

    def write(self, data: bytes) -> None:
        """Sends what the port accepts at once and drops the rest; a port that fails here fails in reading too."""
        taken = 0
        if self._fd is not None:
            try:
                taken = os.write(self._fd, data)
            except OSError:
                taken = 0
        self.unsent += len(data) - taken

    async def _connect_once(self) -> None:
        """Opens the port and reads it until it fails, in whatever way it does."""
        self.state, self._data_received = LinkState.OPENING, False
        try:
            port = await self._open()
        except Exception as error:
            self.state = LinkState.WAITING
            self._report(str(error) or type(error).__name__)
            return
        try:
            self._report(await self._read_until_lost(port.fileno()))
            self._listener.on_closed(time.monotonic())
        finally:
            closing = self._threads.start(partial(close_port, port))
        await self._wait_for(closing, "Closing")

    async def _open(self) -> Port:
        opening = self._threads.start(partial(open_port, self._target, self._baud))
        try:
            await self._wait_for(opening, "Opening")
        except asyncio.CancelledError:
            if opening.done():
                self._close_unused(opening)
            else:
                opening.add_done_callback(self._close_unused)
            raise
        return opening.result()

    def _close_unused(self, opening: asyncio.Future[Port]) -> None:
        if opening.exception() is None:
            self._threads.start(partial(close_port, opening.result()))

    async def _wait_for(self, call: asyncio.Future[Port] | asyncio.Future[None], what: str) -> None:
        """Waits for a thread, and reports it if it is slow; `asyncio.wait` does not cancel what it waits for."""
        await asyncio.wait({call}, timeout=_SLOW)
        if not call.done():
            self._report(f"{what} the port takes more than {_SLOW:g} s: its driver, or the network, hangs.")
            await asyncio.wait({call})

    async def _read_until_lost(self, fd: int) -> str:
        """Passes everything read to the listener until the port is lost; returns why it was."""
        loop = asyncio.get_running_loop()
        lost: asyncio.Future[str] = loop.create_future()
        self._fd, self._opened_at = fd, time.monotonic()
        self.state, self.problem = LinkState.OPEN, ""
        self.connections += 1
        try:
            self._listener.on_opened(self._opened_at)
            loop.add_reader(fd, self._readable, fd, lost)
            return await lost
        finally:
            loop.remove_reader(fd)
            self._fd, self.state = None, LinkState.WAITING

    def _readable(self, fd: int, lost: asyncio.Future[str]) -> None:
        if lost.done():
            return
        try:
            data = os.read(fd, MAX_READ)
        except BlockingIOError:
            return
        except OSError as error:
            lost.set_result(describe_loss(self._target, error))
            return
        at = time.monotonic()
        if not data:
            lost.set_result(describe_loss(self._target, None))
            return
        try:
            self._on_received(data, at)
        except Exception as defect:
            lost.set_exception(defect)

    def _on_received(self, data: bytes, at: float) -> None:
        self._data_received = True
        if self._outage_since is not None and at - self._opened_at >= STEADY_AFTER:
            outage_s = round(self._opened_at - self._outage_since, 1)
            self._log.info("the port works again", port=self.address, outage_s=outage_s)
            self._outage_since = None
        self._listener.on_received(data, at)

    def _report(self, problem: str) -> None:
        self.problem = problem
        if self._outage_since is None:
            self._outage_since = time.monotonic()
            self._log.warning("the port failed; trying again until it works", port=self.address, problem=problem)
