"""Shows the state of a gateway: on a screen if there is a terminal, else line by line."""

from __future__ import annotations

import asyncio
import io
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress

from rich.console import Console
from rich.live import Live

from pretouch_sensor_gateway.watch.keys import Key, parse_keys, raw_keyboard, read_typed
from pretouch_sensor_gateway.watch.log_lines import log_lines
from pretouch_sensor_gateway.watch.state import Watch
from pretouch_sensor_gateway.watch.view import View

REDRAW_PERIOD = 0.125
"""Seconds between two redraws while something changes."""
_IDLE_PERIOD = 1.0
"""Seconds after which the screen is redrawn anyway, because it shows the time."""
LINE_PERIOD = 1.0
"""Seconds between two lines for a device."""


async def show(watch: Watch, seconds: float | None) -> None:
    """Shows `watch` for so long, or until q, Ctrl-C, SIGTERM or SIGHUP, or until the output is closed."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    console = Console()
    end = time.monotonic() + (math.inf if seconds is None else seconds)
    with _stop_signals() as stop:
        try:
            if sys.stdout.isatty() and not console.is_dumb_terminal:
                await _show_screen(watch, console, stop, end)
            else:
                await _print_lines(watch, stop, end)
        except OSError:  # the terminal, or the reader of the pipe, is gone
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


async def _show_screen(watch: Watch, console: Console, stop: asyncio.Event, end: float) -> None:
    with ExitStack() as stack:
        keys = sys.stdin is not None and sys.stdin.isatty()
        if keys:
            stack.enter_context(_keyboard(lambda key: _press(key, watch, stop)))
        live = Live(
            get_renderable=lambda: View(watch, time.monotonic(), time.time(), keys),
            console=console,
            screen=True,
            auto_refresh=False,
        )
        stack.enter_context(live)
        drawn, drawn_at = -1, -math.inf
        while not stop.is_set() and (now := time.monotonic()) < end:
            if watch.changes != drawn or now - drawn_at >= _IDLE_PERIOD:
                drawn, drawn_at = watch.changes, now
                live.refresh()
            await _until(stop, min(now + REDRAW_PERIOD, end))


async def _print_lines(watch: Watch, stop: asyncio.Event, end: float) -> None:
    at = time.monotonic()
    while at < end:
        at = min(at + LINE_PERIOD, end)
        await _until(stop, at)
        if stop.is_set():
            return
        for line in log_lines(watch, time.time()):
            print(line, flush=True)


def _press(key: Key | int, watch: Watch, stop: asyncio.Event) -> None:
    if key is Key.QUIT:
        stop.set()
    elif key is Key.NEXT:
        watch.step(1)
    elif key is Key.PREVIOUS:
        watch.step(-1)
    elif isinstance(key, int):
        watch.select(key - 1)


async def _until(stop: asyncio.Event, end: float) -> None:
    with suppress(TimeoutError):
        async with asyncio.timeout(max(0.0, end - time.monotonic())):
            await stop.wait()


@contextmanager
def _stop_signals() -> Iterator[asyncio.Event]:
    """Yields an event that is set by signals which would end the program, so that the screen is restored first."""
    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    for number in numbers:
        loop.add_signal_handler(number, stop.set)
    try:
        yield stop
    finally:
        for number in numbers:
            loop.remove_signal_handler(number)


@contextmanager
def _keyboard(pressed: Callable[[Key | int], None]) -> Iterator[None]:
    """Calls `pressed` for each key; a terminal that is gone counts as `Key.QUIT`."""
    loop = asyncio.get_running_loop()
    descriptor = sys.stdin.fileno()

    def readable() -> None:
        data = read_typed(descriptor)
        for key in parse_keys(data) if data else [Key.QUIT]:
            pressed(key)

    with raw_keyboard(descriptor):
        loop.add_reader(descriptor, readable)
        try:
            yield
        finally:
            loop.remove_reader(descriptor)
