"""A port that stays open: every kind of failure is an outage, warned of once, and ended by itself."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import serial
from helpers.links import Diary, Ears, Pty, linked
from pretouch_sensor_gateway.transport import port as port_module
from pretouch_sensor_gateway.transport import reconnection
from pretouch_sensor_gateway.transport.address import PathAddress
from pretouch_sensor_gateway.transport.reconnection import Link, LinkState

FRAME = bytes(range(1, 38))
"""As long as a frame of eight modules."""


@pytest.fixture
def pty(tmp_path: Path) -> Iterator[Pty]:
    pty = Pty(tmp_path / "finger")
    yield pty
    with suppress(OSError):
        pty.unplug()


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ports are opened again at once."""
    monkeypatch.setattr(reconnection, "FIRST_DELAY", 0.001)
    monkeypatch.setattr(reconnection, "MAX_DELAY", 0.001)


async def test_bytes_go_both_ways_and_each_read_has_its_time(pty: Pty) -> None:
    before = time.monotonic()
    async with linked(str(pty.path)) as (link, ears):
        await ears.opening(1)
        pty.send(FRAME)
        await ears.hears(FRAME)
        link.write(b"ping")
        assert os.read(pty.master, 100) == b"ping"
        assert (link.address, link.state, link.problem) == (str(pty.path), LinkState.OPEN, "")
        assert (link.connections, link.unsent) == (1, 0)
    assert before <= ears.times[0] <= ears.times[1] <= time.monotonic()
    assert ears.events == ["opened", FRAME]
    assert link.state is not LinkState.OPEN


async def test_every_byte_value_passes_unchanged(pty: Pty) -> None:
    everything = bytes(range(256)) * 8
    async with linked(str(pty.path)) as (link, ears):
        await ears.opening(1)
        pty.send(everything)
        await ears.hears(everything)
        link.write(everything)
        assert os.read(pty.master, 4096) == everything


@pytest.mark.usefixtures("impatient")
async def test_unplugging_at_any_byte_delivers_all_before_and_nothing_after(pty: Pty) -> None:
    async with linked(str(pty.path)) as (link, ears):
        for cut in range(len(FRAME)):
            await ears.opening(cut + 1)
            pty.send(FRAME[:cut])
            await ears.hears(b"".join(FRAME[:n] for n in range(cut + 1)))
            pty.unplug()
            await ears.loss(cut + 1)
            assert link.state is not LinkState.OPEN
            pty.plug()
        await ears.opening(len(FRAME) + 1)
    whole: list[str | bytes] = ["opened", "closed"]
    for cut in range(1, len(FRAME)):
        whole += ["opened", FRAME[:cut], "closed"]
    assert ears.events == [*whole, "opened"]


async def test_an_unplugged_port_is_read_once_more_and_then_left_alone(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    ends: list[int] = []
    read = os.read

    def counting(fd: int, size: int) -> bytes:
        data = read(fd, size)
        if size == reconnection.MAX_READ and not data:
            ends.append(fd)
        return data

    monkeypatch.setattr(os, "read", counting)
    monkeypatch.setattr(reconnection, "FIRST_DELAY", 30.0)
    async with linked(str(pty.path)) as (link, ears):
        await ears.opening(1)
        pty.unplug()
        await ears.loss(1)
        for _ in range(100):
            await asyncio.sleep(0)
        assert len(ends) == 1
        assert link.state is LinkState.WAITING
        assert "unplugged" in link.problem


@pytest.mark.usefixtures("impatient")
async def test_every_kind_of_failure_is_one_outage_with_one_warning(pty: Pty, monkeypatch: pytest.MonkeyPatch) -> None:
    failures = [
        OSError(6, "No such device"),
        termios.error(5, "Input/output error"),
        serial.SerialException("gone"),
        ValueError("a defect of a library"),
    ]

    class FailingAtFirst(serial.Serial):  # type: ignore[misc]
        def open(self) -> None:
            if failures:
                raise failures.pop(0)
            super().open()

    monkeypatch.setattr(serial, "Serial", FailingAtFirst)
    monkeypatch.setattr(reconnection, "STEADY_AFTER", 0.0)
    diary = Diary()
    async with linked(str(pty.path), diary) as (link, ears):
        await ears.opening(1)
        pty.send(b"hello")
        await ears.hears(b"hello")
        assert (link.state, link.problem, link.connections) == (LinkState.OPEN, "", 1)
    assert diary.kinds == ["warning", "info"]
    assert diary.entries[0][1]["port"] == str(pty.path)
    assert ears.events == ["opened", b"hello"]


@pytest.mark.usefixtures("impatient")
async def test_a_flapping_port_warns_once_until_its_data_flow_steadily(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    diary = Diary()
    async with linked(str(pty.path), diary) as (link, ears):
        for flap in range(1, 21):
            await ears.opening(flap)
            pty.send(b"x")
            await ears.hears(b"x" * flap)
            pty.unplug()
            await ears.loss(flap)
            pty.plug()
        await ears.opening(21)
        assert diary.kinds == ["warning"]
        monkeypatch.setattr(reconnection, "STEADY_AFTER", 0.0)
        pty.send(b"x")
        await ears.hears(b"x" * 21)
        assert diary.kinds == ["warning", "info"]
        pty.unplug()
        await ears.loss(21)
        assert diary.kinds == ["warning", "info", "warning"]
        assert link.connections == 21


async def test_the_wait_between_two_tries_doubles_to_a_limit_and_starts_over_once_bytes_came(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits: list[float] = []
    sleep = asyncio.sleep

    async def noting(delay: float) -> None:
        waits.append(delay)
        if len(waits) == 8:
            pty.plug()
        await sleep(0)

    pty.unplug()
    monkeypatch.setattr(asyncio, "sleep", noting)
    async with linked(str(pty.path)) as (_, ears):
        await ears.opening(1)
        assert waits == [0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0]
        pty.send(b"x")
        await ears.hears(b"x")
        pty.unplug()
        await ears.loss(1)
        pty.plug()
        await ears.opening(2)
        assert waits[8] == 0.1


@pytest.mark.usefixtures("impatient")
async def test_a_link_whose_device_comes_later_opens_it_when_it_is_there(pty: Pty) -> None:
    pty.unplug()
    diary = Diary()
    async with linked(str(pty.path), diary) as (link, ears):
        await diary.written.wait()
        assert link.problem == f"There is no device at {pty.path}: it is not plugged in, or it has another name."
        assert link.connections == 0
        pty.plug()
        await ears.opening(1)
    assert ears.events == ["opened"]


@pytest.mark.usefixtures("impatient")
async def test_a_port_that_another_process_holds_is_waited_for(pty: Pty) -> None:
    diary = Diary()
    program = "import serial, sys; p = serial.Serial(sys.argv[1], exclusive=True); print(flush=True); sys.stdin.read()"
    holder = await asyncio.create_subprocess_exec(
        sys.executable, "-c", program, str(pty.path), stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert holder.stdin is not None
    assert holder.stdout is not None
    await holder.stdout.readline()
    async with linked(str(pty.path), diary) as (link, ears):
        await diary.written.wait()
        assert "Another program" in link.problem
        assert f"fuser -v {pty.path}" in link.problem
        holder.stdin.close()
        await ears.opening(1)
        assert link.problem == ""
    assert await holder.wait() == 0


async def test_a_port_is_taken_by_one_link_only_and_is_free_after_it(pty: Pty) -> None:
    async with linked(str(pty.path)) as (_, first):
        await first.opening(1)
        diary = Diary()
        async with linked(str(pty.path), diary):
            await diary.written.wait()
        assert "Another program" in diary.entries[0][1]["problem"]
        pty.send(b"still the first's")
        await first.hears(b"still the first's")
    async with linked(str(pty.path)) as (_, third):
        await third.opening(1)


async def test_no_other_user_can_open_a_port_that_is_no_pty_until_the_link_ends(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(port_module, "_PTY_MAJORS", range(0))
    user: dict[str, Any] = {"user": 65534, "group": 65534, "extra_groups": []} if os.geteuid() == 0 else {}
    if user:  # the superuser is not kept out
        os.chown(pty.slave_path, 65534, 65534)

    def complaint() -> str:
        command = ["/bin/sh", "-c", ': <>"$1"', "sh", pty.slave_path]
        done = subprocess.run(
            command, cwd="/", env={"LC_ALL": "C"}, capture_output=True, text=True, check=False, **user
        )
        return done.stderr

    async with linked(str(pty.path)) as (_, ears):
        await ears.opening(1)
        assert "busy" in await asyncio.to_thread(complaint)
    assert await asyncio.to_thread(complaint) == ""


async def test_what_a_full_port_does_not_take_is_dropped_and_counted(pty: Pty) -> None:
    async with linked(str(pty.path)) as (link, ears):
        await ears.opening(1)
        written = 0
        while not link.unsent:
            link.write(FRAME)
            written += len(FRAME)
        pty.send(b"x")
        await ears.hears(b"x")
        arrived = bytearray()
        with suppress(BlockingIOError):
            while data := os.read(pty.master, 65536):
                arrived += data
        assert len(arrived) == written - link.unsent


def test_closing_drops_what_the_device_has_not_taken_for_the_driver_would_wait_for_it(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []

    class Noting(serial.Serial):  # type: ignore[misc]
        def reset_output_buffer(self) -> None:
            calls.append("drop")

        def close(self) -> None:
            if self.is_open:
                calls.append("close")
            super().close()

    monkeypatch.setattr(serial, "Serial", Noting)
    port_module.close_port(port_module.open_port(PathAddress(str(pty.path)), reconnection.DEFAULT_BAUD))
    assert calls == ["drop", "close"]


async def test_writing_to_a_closed_port_is_no_error() -> None:
    link = Link("/dev/none", Ears(), Diary())  # type: ignore[arg-type]
    link.write(b"ping")
    assert link.unsent == 4


@pytest.mark.usefixtures("impatient")
async def test_writing_to_an_unplugged_port_is_no_error(pty: Pty) -> None:
    async with linked(str(pty.path)) as (link, ears):
        await ears.opening(1)
        pty.unplug()
        link.write(b"ping")
        assert link.unsent == 4
        await ears.loss(1)


async def test_a_device_that_never_stops_sending_leaves_the_others_their_turn() -> None:
    flood = bytes(64 * reconnection.MAX_READ)
    reads: list[tuple[int, int]] = []
    turn = 0

    class Counting(Ears):
        def on_received(self, data: bytes, at: float) -> None:
            reads.append((turn, len(data)))
            super().on_received(data, at)

    async def send(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(flood)
        writer.close()

    ears = Counting()
    async with await asyncio.start_server(send, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        running = asyncio.create_task(Link(f"socket://127.0.0.1:{port}", ears, Diary()).run())  # type: ignore[arg-type]
        while len(ears.heard) < len(flood):
            turn += 1
            await asyncio.sleep(0)
        running.cancel()
        await asyncio.wait({running})
    turns = [at for at, _ in reads]
    assert len(set(turns)) == len(turns)
    assert max(size for _, size in reads) <= reconnection.MAX_READ


async def test_an_empty_port_is_not_taken_for_one_that_hung_up(pty: Pty) -> None:
    port = port_module.open_port(PathAddress(str(pty.path)), reconnection.DEFAULT_BAUD)
    with pytest.raises(BlockingIOError):
        os.read(port.fileno(), 1)
    port_module.close_port(port)
