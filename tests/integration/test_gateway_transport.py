"""A port that stays open: every kind of failure is an outage, warned of once, and ended by itself."""

from __future__ import annotations

import asyncio
import os
import termios
import tty
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Any

import pytest
import serial
import structlog
from pretouch_sensor_gateway import transport
from pretouch_sensor_gateway.transport import Link, LinkState


class Ears:
    """Hears what a link says."""

    def __init__(self) -> None:
        self.heard = bytearray()
        self.openings = 0
        self.news = asyncio.Event()

    def opened(self) -> None:
        self.openings += 1
        self.news.set()

    def received(self, data: bytes, at: float) -> None:
        self.heard += data
        self.news.set()

    async def opening(self, number: int) -> None:
        while self.openings < number:
            await self.news.wait()
            self.news.clear()

    async def until(self, wanted: bytes) -> None:
        while bytes(self.heard) != wanted:
            assert wanted.startswith(self.heard)
            await self.news.wait()
            self.news.clear()


class Diary:
    """A log that remembers."""

    def __init__(self) -> None:
        self.entries: list[tuple[str, str]] = []
        self.warned = asyncio.Event()

    def warning(self, _: str, *, port: str, problem: str) -> None:
        self.entries.append(("warning", problem))
        self.warned.set()

    def info(self, event: str, *, port: str) -> None:
        self.entries.append(("info", event))


@asynccontextmanager
async def linked(url: str, diary: Diary | None = None) -> AsyncIterator[tuple[Link, Ears]]:
    ears = Ears()
    link = Link(url, ears, diary or structlog.get_logger())  # type: ignore[arg-type]
    task = asyncio.create_task(link.run())
    async with asyncio.timeout(30):
        try:
            yield link, ears
        finally:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task


async def test_every_kind_of_failure_is_one_outage_with_one_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transport, "FIRST_DELAY", 0.001)
    master, slave = os.openpty()
    tty.setraw(slave)
    failures: list[Exception] = [
        OSError(6, "No such device"),
        termios.error(5, "Input/output error"),
        serial.SerialException("gone"),
    ]
    open_port = serial.serial_for_url

    def opening(url: str, **options: Any) -> Any:
        if failures:
            raise failures.pop(0)
        return open_port(url, **options)

    monkeypatch.setattr(serial, "serial_for_url", opening)
    diary = Diary()
    async with linked(os.ttyname(slave), diary) as (link, ears):
        await ears.opening(1)
        os.write(master, b"hello")
        await ears.until(b"hello")
        assert (link.state, link.problem) == (LinkState.OPEN, "")
    assert [kind for kind, _ in diary.entries] == ["warning", "info"]
    os.close(master)
    os.close(slave)


async def test_a_port_is_taken_by_one_gateway_only() -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    async with linked(os.ttyname(slave)) as (_, first):
        await first.opening(1)
        diary = Diary()
        async with linked(os.ttyname(slave), diary):
            await diary.warned.wait()
        assert "lock" in diary.entries[0][1]
        os.write(master, b"still the first's")
        await first.until(b"still the first's")
    os.close(master)
    os.close(slave)


async def test_a_socket_is_a_port_too_and_is_opened_again_when_it_hangs_up() -> None:
    async def answer_once(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(await reader.readexactly(4))
        writer.close()

    async with await asyncio.start_server(answer_once, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        async with linked(f"socket://127.0.0.1:{port}") as (link, ears):
            await ears.opening(1)
            await link.write(b"ping")
            await ears.until(b"ping")
            await ears.opening(2)
            await link.write(b"pong")
            await ears.until(b"pingpong")


async def test_writing_to_a_closed_port_is_no_error() -> None:
    link = Link("/dev/none", Ears(), structlog.get_logger())
    await link.write(b"ping")
