"""The two sides of a port link: a listener and a log that record, and a pty that can be unplugged.

Helper of `test_gateway_transport*.py`.
"""

from __future__ import annotations

import asyncio
import os
import tty
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

from pretouch_sensor_gateway.transport.reconnection import Link


class Ears:
    """Records a link's events in order: "opened", "closed" and bytes (those received together as one)."""

    def __init__(self) -> None:
        self.events: list[str | bytes] = []
        self.times: list[float] = []
        self._news = asyncio.Event()

    def on_opened(self, at: float) -> None:
        self._note("opened", at)

    def on_received(self, data: bytes, at: float) -> None:
        if self.events and isinstance(last := self.events[-1], bytes):
            data = last + data
            del self.events[-1]
        self._note(data, at)

    def on_closed(self, at: float) -> None:
        self._note("closed", at)

    @property
    def heard(self) -> bytes:
        return b"".join(event for event in self.events if isinstance(event, bytes))

    async def until(self, come: Callable[[], bool]) -> None:
        while not come():
            await self._news.wait()
            self._news.clear()

    async def hears(self, data: bytes) -> None:
        await self.until(lambda: len(self.heard) >= len(data))
        assert self.heard == data

    async def opening(self, number: int) -> None:
        await self.until(lambda: self.events.count("opened") >= number)

    async def loss(self, number: int) -> None:
        await self.until(lambda: self.events.count("closed") >= number)

    def _note(self, event: str | bytes, at: float) -> None:
        self.events.append(event)
        self.times.append(at)
        self._news.set()


async def eventually(condition: Callable[[], bool]) -> None:
    """Polls until the condition holds."""
    while not condition():  # noqa: ASYNC110
        await asyncio.sleep(0.001)


class Diary:
    """A log that records its lines."""

    def __init__(self) -> None:
        self.entries: list[tuple[str, dict[str, Any]]] = []
        self.written = asyncio.Event()

    def warning(self, _: str, **facts: Any) -> None:
        self.entries.append(("warning", facts))
        self.written.set()

    def info(self, _: str, **facts: Any) -> None:
        self.entries.append(("info", facts))
        self.written.set()

    @property
    def kinds(self) -> list[str]:
        return [kind for kind, _ in self.entries]


@asynccontextmanager
async def linked(address: str, diary: Diary | None = None) -> AsyncIterator[tuple[Link, Ears]]:
    """A link that runs for as long as the block, which fails if it takes half a minute."""
    ears = Ears()
    link = Link(address, ears, diary or Diary())  # type: ignore[arg-type]
    async with asyncio.timeout(30):
        task = asyncio.create_task(link.run())
        try:
            yield link, ears
        finally:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task


class Pty:
    """A port whose device end this process holds, reached by a symbolic link that goes when it is unplugged."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.plug()

    def plug(self) -> None:
        self.master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self.master, False)
        self.slave_path = os.ttyname(slave)
        fresh = self.path.with_suffix(".new")
        fresh.symlink_to(self.slave_path)
        fresh.replace(self.path)
        self._slave = slave  # kept open: reading a master without an open slave is an error

    def send(self, data: bytes) -> None:
        assert os.write(self.master, data) == len(data)

    @property
    def plugged(self) -> bool:
        return self.path.is_symlink()

    def unplug(self) -> None:
        self.path.unlink()
        os.close(self.master)
        os.close(self._slave)
