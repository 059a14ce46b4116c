"""A gateway of one device within this process, for programs that want to talk to a device and find no gateway."""

from __future__ import annotations

import asyncio
import io
import logging
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from functools import partial

import structlog

from pretouch.serving import Settings, started
from pretouch_sensor_gateway.configuration import DEFAULT_BAUD, DeviceSetting, GatewaySetting
from pretouch_sensor_gateway.service import serving
from pretouch_sensor_gateway.wire_formats.recognition import AUTO

DEVICE = "finger"
"""What the device is called."""
_GRACE = 0.5
"""Seconds that calls get to end."""
_PATIENCE = 10.0
"""Seconds after which a gateway that hangs is left behind."""


@contextmanager
def local_gateway(address: str, wire_format: str = AUTO, baud: int = DEFAULT_BAUD) -> Iterator[str]:
    """Serves the device at `address` on a free port of 127.0.0.1, in a thread; gives host:port of gRPC.

    What the gateway logs as an error is printed to standard error afterwards, the rest is dropped: the program at work
    has the terminal, and the device's status tells what is wrong with it.

    Raises:
        InvalidInput: address, format or baud rate cannot be.
    """
    setting = GatewaySetting((DeviceSetting(DEVICE, address, wire_format, baud),))
    ready: Future[tuple[str, asyncio.AbstractEventLoop, asyncio.Event]] = Future()
    with _held_log():
        thread = threading.Thread(target=lambda: asyncio.run(_serve(setting, ready)), name="gateway", daemon=True)
        thread.start()
        where, loop, stop = ready.result()
        try:
            yield where
        finally:
            with suppress(RuntimeError):  # its loop is closed: it has ended by itself
                loop.call_soon_threadsafe(stop.set)
            thread.join(_PATIENCE)


async def _serve(setting: GatewaySetting, ready: Future[tuple[str, asyncio.AbstractEventLoop, asyncio.Event]]) -> None:
    stop = asyncio.Event()
    try:
        settings = Settings(grace=_GRACE)
        async with started("gateway", partial(serving, setting=setting), settings) as service:
            ready.set_result((settings.address(service.port), asyncio.get_running_loop(), stop))
            await stop.wait()
    except Exception as error:
        if ready.done():
            raise
        ready.set_exception(error)


@contextmanager
def _held_log() -> Iterator[None]:
    """Keeps the log's errors until the block ends."""
    before = structlog.get_config()
    held = io.StringIO()
    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR),
        logger_factory=structlog.PrintLoggerFactory(held),
        cache_logger_on_first_use=False,
    )
    try:
        yield
    finally:
        structlog.configure(**before)
        sys.stderr.write(held.getvalue())
