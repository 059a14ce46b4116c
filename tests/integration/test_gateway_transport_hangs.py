"""A port that hangs, a link that is cancelled, outages by the hundred: nothing is held up and nothing stays open."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from helpers.links import Diary, Ears, Pty, eventually, linked
from pretouch_sensor_gateway.transport import reconnection
from pretouch_sensor_gateway.transport.address import Address, PathAddress
from pretouch_sensor_gateway.transport.port import Port, close_port, open_port
from pretouch_sensor_gateway.transport.reconnection import Link, LinkState


@pytest.fixture
def pty(tmp_path: Path) -> Iterator[Pty]:
    pty = Pty(tmp_path / "finger")
    yield pty
    with suppress(OSError):
        pty.unplug()


def open_files() -> int:
    return len(os.listdir("/proc/self/fd"))


async def no_more_open_than(before: int) -> None:
    """At last; other threads of this process open and close files too."""
    async with asyncio.timeout(30):
        await eventually(lambda: open_files() <= before)


def open_at(path: Path) -> int:
    """Of this process's open files, those that are `path`."""
    found = 0
    for descriptor in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # one that was closed meanwhile
            found += descriptor.readlink() == path.resolve()
    return found


class Hanging:
    """Opening, or closing, that hangs for the path /dev/hangs until it is let go."""

    def __init__(self, stand_in: Path) -> None:
        self._stand_in = PathAddress(str(stand_in))
        self._go = threading.Event()
        self.closed = threading.Event()

    def open(self, address: Address, baud: int) -> Port:
        if address != PathAddress("/dev/hangs"):
            return open_port(address, baud)
        self._go.wait()
        return open_port(self._stand_in, baud)

    def close(self, port: Port) -> None:
        self._go.wait()
        close_port(port)
        self.closed.set()

    def let_go(self) -> None:
        self._go.set()


@pytest.fixture
def hanging(tmp_path: Path) -> Iterator[Hanging]:
    stand_in = Pty(tmp_path / "stand-in")
    hanging = Hanging(stand_in.path)
    yield hanging
    hanging.let_go()
    stand_in.unplug()


async def test_a_port_whose_opening_hangs_holds_up_neither_the_others_nor_the_end(
    pty: Pty, hanging: Hanging, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reconnection, "open_port", hanging.open)
    monkeypatch.setattr(reconnection, "_SLOW", 0.001)
    monkeypatch.setattr(reconnection, "_PATIENCE", 0.001)
    diary = Diary()
    before = open_files()
    async with linked("/dev/hangs", diary) as (stuck, _):
        await diary.written.wait()
        assert stuck.problem == "Opening the port takes more than 0.001 s: its driver, or the network, hangs."
        assert stuck.state is LinkState.OPENING
        async with linked(str(pty.path)) as (_, ears):
            await ears.opening(1)
            pty.send(b"well")
            await ears.hears(b"well")
    assert diary.kinds == ["warning"]

    closed = asyncio.Event()
    loop = asyncio.get_running_loop()

    def close(port: Port) -> None:
        close_port(port)
        loop.call_soon_threadsafe(closed.set)

    monkeypatch.setattr(reconnection, "close_port", close)
    hanging.let_go()
    await closed.wait()  # what opened after the end is closed at once
    await no_more_open_than(before)


async def test_a_port_whose_closing_hangs_is_not_opened_twice_and_holds_up_nothing(
    pty: Pty, hanging: Hanging, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reconnection, "close_port", hanging.close)
    monkeypatch.setattr(reconnection, "_SLOW", 0.001)
    monkeypatch.setattr(reconnection, "_PATIENCE", 0.001)
    monkeypatch.setattr(reconnection, "FIRST_DELAY", 0.001)
    async with linked(str(pty.path)) as (link, ears):
        await ears.opening(1)
        pty.unplug()
        await ears.loss(1)
        pty.plug()
        await eventually(lambda: link.problem.startswith("Closing"))
        assert link.connections == 1
        hanging.let_go()
        await ears.opening(2)
        assert link.problem == ""


def test_an_opening_that_hangs_does_not_keep_the_program_from_ending() -> None:
    program = """
import asyncio, logging, threading
from pretouch_sensor_gateway.transport import reconnection

class Nobody:
    on_opened = on_received = on_closed = print

async def main():
    hangs = asyncio.Event()
    loop = asyncio.get_running_loop()
    def hang(*_):
        loop.call_soon_threadsafe(hangs.set)
        threading.Event().wait()
    reconnection.open_port = hang
    running = asyncio.create_task(reconnection.Link("/dev/hangs", Nobody(), logging).run())
    await hangs.wait()
    running.cancel()
    await asyncio.wait({running})

asyncio.run(main())
"""
    done = subprocess.run([sys.executable, "-c", program], timeout=60, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("kind", ["pty", "socket", "absent"])
async def test_two_hundred_outages_leave_no_file_open(
    kind: str, pty: Pty, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reconnection, "FIRST_DELAY", 0.0)
    tries = 0

    def counting(address: Address, baud: int) -> Port:
        nonlocal tries
        tries += 1
        return open_port(address, baud)

    monkeypatch.setattr(reconnection, "open_port", counting)

    async def hang_up(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"x")
        writer.close()

    before, threads = open_files(), threading.active_count()
    async with await asyncio.start_server(hang_up, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        addresses = {"pty": str(pty.path), "socket": f"socket://127.0.0.1:{port}", "absent": str(tmp_path / "absent")}
        async with linked(addresses[kind]) as (_, ears):
            for outage in range(1, 201):
                if kind == "pty":
                    await ears.opening(outage)
                    pty.unplug()
                    pty.plug()
                if kind != "absent":
                    await ears.loss(outage)
            await eventually(lambda: tries > 200)
    async with asyncio.timeout(30):  # the server's ends close a little later
        await eventually(lambda: open_files() <= before and threading.active_count() <= threads)


async def test_a_link_that_is_cancelled_at_any_point_leaves_its_port_closed(pty: Pty) -> None:
    before, port_before = open_files(), open_at(pty.path)
    ears = Ears()
    for turns in range(60):
        running = asyncio.create_task(Link(str(pty.path), ears, Diary()).run())  # type: ignore[arg-type]
        for _ in range(turns):
            await asyncio.sleep(0)
        running.cancel()
        await asyncio.wait({running})
        assert running.cancelled()
        assert open_at(pty.path) == port_before
    await no_more_open_than(before)


async def test_a_link_that_is_cancelled_in_the_turn_in_which_its_port_opens_closes_it(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    began, go = asyncio.Event(), threading.Event()
    loop = asyncio.get_running_loop()
    opened: list[Port] = []
    closed: list[Port] = []

    def opening(address: Address, baud: int) -> Port:
        loop.call_soon_threadsafe(began.set)
        go.wait()
        opened.append(open_port(address, baud))
        return opened[0]

    def close(port: Port) -> None:
        closed.append(port)
        close_port(port)

    monkeypatch.setattr(reconnection, "open_port", opening)
    monkeypatch.setattr(reconnection, "close_port", close)
    ears = Ears()
    running = asyncio.create_task(Link(str(pty.path), ears, Diary()).run())  # type: ignore[arg-type]
    await began.wait()
    go.set()
    for thread in threading.enumerate():
        if thread.name == f"port {pty.path}":
            thread.join()  # and the loop, which this blocks, has yet to learn that the port is open
    running.cancel()
    await asyncio.wait({running})
    assert closed == opened
    assert len(opened) == 1
    assert ears.events == []


async def test_a_listeners_defect_ends_the_link_with_the_port_closed(pty: Pty) -> None:
    class Deaf(Ears):
        def on_received(self, data: bytes, at: float) -> None:
            raise OSError("a defect")

    before = open_files()
    ears = Deaf()
    running = asyncio.create_task(Link(str(pty.path), ears, Diary()).run())  # type: ignore[arg-type]
    await ears.opening(1)
    pty.send(b"x")
    with pytest.raises(OSError, match="a defect"):
        await running
    assert ears.events == ["opened"]
    await no_more_open_than(before)
