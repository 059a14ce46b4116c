"""Shows the state of a gateway: on a screen if there is a terminal, else line by line."""

from __future__ import annotations

import asyncio
import io
import math
import os
import signal
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress

from rich.console import Console
from rich.live import Live

from pretouch_sensor_gateway.watch.log_lines import log_lines
from pretouch_sensor_gateway.watch.state import Watch
from pretouch_sensor_gateway.watch.view import draw

REDRAW_PERIOD = 0.125
"""Seconds between two redraws while something changes."""
LINE_PERIOD = 1.0
"""Seconds between two lines for a device, and between redraws while nothing changes: the screen shows the time."""


async def show(watch: Watch, seconds: float | None) -> None:
    """Shows `watch` for so long, or until q, Ctrl-C, SIGTERM or SIGHUP, or until the output is closed."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    console = Console()
    end = time.monotonic() + (math.inf if seconds is None else seconds)
    with _stop_signals() as stop:
        try:
            if sys.stdout.isatty() and not console.is_dumb_terminal:
                await _Screen(watch, console, stop).show(end)
            else:
                await _print_lines(watch, stop, end)
        except OSError:  # the terminal, or the reader of the pipe, is gone
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class _Screen:
    def __init__(self, watch: Watch, console: Console, stop: asyncio.Event) -> None:
        self._watch = watch
        self._console = console
        self._stop = stop
        self._raw = False

    async def show(self, end: float) -> None:
        with ExitStack() as stack:
            if sys.stdin is not None and sys.stdin.isatty():
                stack.enter_context(_keyboard(self._press))
            live = Live(
                get_renderable=lambda: draw(self._watch, time.monotonic(), time.time(), self._raw),
                console=self._console,
                screen=True,
                auto_refresh=False,
                vertical_overflow="crop",
            )
            stack.enter_context(live)
            drawn, drawn_at = -1, -math.inf
            while not self._stop.is_set() and (now := time.monotonic()) < end:
                if self._watch.changes != drawn or now - drawn_at >= LINE_PERIOD:
                    drawn, drawn_at = self._watch.changes, now
                    live.refresh()
                await _until(self._stop, min(now + REDRAW_PERIOD, end))

    def _press(self, typed: bytes) -> None:
        """Nothing typed: the terminal is gone."""
        if not typed or b"q" in typed:
            self._stop.set()
        if b"\t" in typed:
            self._watch.select_next()
        if b"r" in typed:
            self._raw = not self._raw
            self._watch.changes += 1


async def _print_lines(watch: Watch, stop: asyncio.Event, end: float) -> None:
    at = time.monotonic()
    while at < end:
        at = min(at + LINE_PERIOD, end)
        await _until(stop, at)
        if stop.is_set():
            return
        for line in log_lines(watch, time.time()):
            print(line, flush=True)


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
def _keyboard(pressed: Callable[[bytes], None]) -> Iterator[None]:
    """Passes what is typed at once and without echo; restores the terminal afterwards."""
    loop = asyncio.get_running_loop()
    descriptor = sys.stdin.fileno()

    def read() -> None:
        typed = b""
        with suppress(OSError):
            typed = os.read(descriptor, 1024)
        pressed(typed)

    before = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor)
    loop.add_reader(descriptor, read)
    try:
        yield
    finally:
        loop.remove_reader(descriptor)
        with suppress(termios.error):  # the terminal is gone
            termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
