"""TCP links on loopback that can be cut: a network that fails on demand."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Coroutine, Sequence
from contextlib import suppress
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar

import httpx

T = TypeVar("T")
Target = tuple[str, int] | Path
"""host and port, or a Unix socket."""
_CHUNK = 2**16
_CONNECT = 2.0  # s
_PROBE_EVERY, _PROBE_TIMEOUT, _PROBE_MISSES = 1.0, 3.0, 2


class Flow(Enum):
    OPEN = "open"
    DROPPED = "dropped"
    """Connections are reset, and new ones too."""
    LOST = "lost"
    """Nothing arrives any more, and nothing says so; what was under way arrives once the link is mended."""


class Link:
    """A port of loopback that leads to one of `targets`, in turn.

    Args:
        health: URLs, one for each target. Targets that do not answer 200 are left out while another one does, and
            their connections are reset.
    """

    def __init__(self, targets: Sequence[Target], health: Sequence[str] = ()) -> None:
        self.targets = targets
        self.port = 0
        self._health = health
        self._well = [True] * len(targets)
        self._next = 0
        self._flow = Flow.OPEN
        self._flowing = asyncio.Event()
        self._flowing.set()
        self._connections: dict[asyncio.WriteTransport, int] = {}

    async def listen(self) -> asyncio.Server:
        """Opens the port."""
        server = await asyncio.start_server(self._connect, "127.0.0.1", 0)
        self.port = server.sockets[0].getsockname()[1]
        return server

    async def serve(self, server: asyncio.Server) -> None:
        """Serves the open port, and watches over the targets, until it is cancelled."""
        async with server, asyncio.TaskGroup() as group:
            for index, url in enumerate(self._health):
                group.create_task(self._probe(index, url))
            await server.serve_forever()

    def set_flow(self, flow: Flow) -> None:
        self._flow = flow
        if flow is Flow.LOST:
            self._flowing.clear()
        else:
            self._flowing.set()
        if flow is Flow.DROPPED:
            self._reset(range(len(self.targets)))

    async def _connect(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            await self._flowing.wait()
            if self._flow is Flow.OPEN:
                await self._pass_on(reader, writer)
        except OSError:
            pass
        finally:
            writer.transport.abort()

    async def _pass_on(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        for index in self._in_turn():
            with suppress(OSError, TimeoutError):
                async with asyncio.timeout(_CONNECT):
                    there, back = await _open(self.targets[index])
                break
        else:
            return
        ends = (writer.transport, back.transport)
        self._connections |= dict.fromkeys(ends, index)
        ways = [asyncio.create_task(self._pump(reader, back)), asyncio.create_task(self._pump(there, writer))]
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)
            back.transport.abort()
            for end in ends:
                del self._connections[end]

    async def _pump(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            while data := await reader.read(_CHUNK):
                await self._flowing.wait()
                writer.write(data)
                await writer.drain()

    def _in_turn(self) -> list[int]:
        """The targets, the next one first; those that are not well last."""
        count = len(self.targets)
        self._next = (self._next + 1) % count
        turn = [(self._next + k) % count for k in range(count)]
        return sorted(turn, key=lambda index: not self._well[index])

    async def _probe(self, index: int, url: str) -> None:
        misses = 0
        async with httpx.AsyncClient(trust_env=False, timeout=_PROBE_TIMEOUT) as client:
            while True:
                try:
                    well = (await client.get(url)).status_code == 200
                except httpx.HTTPError:
                    well = False
                misses = 0 if well else misses + 1
                if self._well[index] and misses >= _PROBE_MISSES:
                    self._reset([index])
                self._well[index] = misses < _PROBE_MISSES
                await asyncio.sleep(_PROBE_EVERY)

    def _reset(self, indices: Sequence[int] | range) -> None:
        for end, index in list(self._connections.items()):
            if index in indices:
                end.abort()


async def _open(target: Target) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    if isinstance(target, Path):
        return await asyncio.open_unix_connection(target)
    return await asyncio.open_connection(*target)


class Network:
    """Links in a thread of their own; use it in a `with` block."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="links", daemon=True)
        self._tasks: list[asyncio.Task[None]] = []

    def __enter__(self) -> Network:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._run(self._end())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def link(self, targets: Sequence[Target], health: Sequence[str] = ()) -> Link:
        """A new link, which listens."""
        return self._run(self._add(targets, health))

    def set_flow(self, links: Sequence[Link], flow: Flow) -> None:
        async def each() -> None:
            for link in links:
                link.set_flow(flow)

        self._run(each())

    async def _add(self, targets: Sequence[Target], health: Sequence[str]) -> Link:
        link = Link(targets, health)
        self._tasks.append(asyncio.create_task(link.serve(await link.listen())))
        return link

    async def _end(self) -> None:
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)

    def _run(self, coroutine: Coroutine[Any, Any, T]) -> T:
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result()
