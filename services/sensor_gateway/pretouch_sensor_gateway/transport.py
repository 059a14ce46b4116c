"""A serial port that stays open: read in a thread, opened again after every outage.

The port is a path (`/dev/serial/by-id/...` names survive replugging) or any URL that pyserial knows, such as
`socket://host:port`. pyserial's blocking port in a thread works for all of these, and the thread stamps each read at
once, however busy the event loop is.

    OPENING ──▶ OPEN ──(error)──▶ WAITING ──(backoff)──▶ OPENING ...
"""

from __future__ import annotations

import asyncio
import termios
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from enum import Enum
from typing import Any, Protocol

import serial
import structlog

BAUD = 115_200
"""Bits a second of a real UART; USB and sockets ignore it."""
FIRST_DELAY = 0.1
"""Seconds before a port is opened again for the first time; doubles with every further failure."""
MAX_DELAY = 5.0
_READ_TIMEOUT = 0.1
_WRITE_TIMEOUT = 1.0
_MAX_READ = 4096
_PORT_ERRORS = (OSError, termios.error, serial.SerialException)
"""What a port that is unplugged, taken or missing raises: which of them depends on the driver and the moment."""


class LinkState(Enum):
    """How the port fares."""

    OPENING = "opening"
    OPEN = "open"
    WAITING = "waiting to open again"


class Listener(Protocol):
    """Who hears what happens on a link; called on the event loop."""

    def opened(self) -> None:
        """The port is open: what was half received before is void."""
        ...

    def received(self, data: bytes, at: float) -> None:
        """Bytes, and the `time.monotonic()` at which they were read."""
        ...


class Link:
    """One serial port.

    Attributes:
        url: path or pyserial URL.
        state: how the port fares.
        problem: why the port is not open, "" when it is.
    """

    def __init__(self, url: str, listener: Listener, log: structlog.typing.FilteringBoundLogger) -> None:
        self.url = url
        self.state = LinkState.OPENING
        self.problem = ""
        self._listener = listener
        self._log = log
        self._port: serial.SerialBase | None = None
        self._port_lock = threading.Lock()
        self._heard = False  # anything, since the last outage
        self._warned = False

    async def run(self) -> None:
        """Keeps the port open until cancelled."""
        loop = asyncio.get_running_loop()
        threads = ThreadPoolExecutor(1, thread_name_prefix=f"port {self.url}")
        delay = FIRST_DELAY
        try:
            while True:
                self.state, self._heard = LinkState.OPENING, False
                stop = threading.Event()
                session = loop.run_in_executor(threads, self._session, stop, loop)
                try:
                    await asyncio.shield(session)
                except _PORT_ERRORS as error:
                    self._failed(error)
                except asyncio.CancelledError:
                    stop.set()
                    await asyncio.wait({session}, timeout=1.0)
                    if session.done() and not session.cancelled():
                        session.exception()
                    raise
                if self._heard:
                    delay = FIRST_DELAY
                await asyncio.sleep(delay)
                delay = min(2 * delay, MAX_DELAY)
        finally:
            threads.shutdown(wait=False)

    async def write(self, data: bytes) -> None:
        """Sends `data` if the port is open; a port that fails here fails in reading too, and is opened again."""
        with suppress(*_PORT_ERRORS):
            await asyncio.to_thread(self._write, data)

    def _write(self, data: bytes) -> None:
        with self._port_lock:
            if self._port is not None:
                self._port.write(data)

    def _session(self, stop: threading.Event, loop: asyncio.AbstractEventLoop) -> None:
        """In the thread: opens the port and reads until told to stop or the port fails."""

        def post(call: Any, *args: Any) -> None:
            with suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(call, *args)

        port = serial.serial_for_url(
            self.url, baudrate=BAUD, timeout=_READ_TIMEOUT, write_timeout=_WRITE_TIMEOUT, exclusive=True
        )
        self._port = port
        try:
            post(self._opened)
            while not stop.is_set():
                data = _read(port)
                if data:
                    post(self._received, data, time.monotonic())
        finally:
            with self._port_lock:
                self._port = None
                port.close()

    def _opened(self) -> None:
        self.state, self.problem = LinkState.OPEN, ""
        self._listener.opened()

    def _received(self, data: bytes, at: float) -> None:
        if not self._heard:
            self._heard = True
            self._log.info("the port sends", port=self.url)
            self._warned = False
        self._listener.received(data, at)

    def _failed(self, error: BaseException) -> None:
        self.state, self.problem = LinkState.WAITING, str(error) or type(error).__name__
        if not self._warned:
            self._warned = True
            self._log.warning("the port failed; trying again until it works", port=self.url, problem=self.problem)


def _read(port: Any) -> bytes:
    """What has come, waiting up to the read timeout for the first byte; b"" if nothing did."""
    data: bytes = port.read(1)
    with suppress(*_PORT_ERRORS):  # what has come counts; the next read fails again
        while data and len(data) < _MAX_READ and (waiting := port.in_waiting):
            data += port.read(min(waiting, _MAX_READ - len(data)))
    return data
