"""What a port may be besides a path: a serial server on the network, or a USB device by its numbers."""

from __future__ import annotations

import asyncio
import os
import socket
import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from helpers.links import Diary, Pty, linked
from pretouch_sensor_gateway.transport import reconnection
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo


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


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("reset", [False, True])
async def test_a_socket_is_a_port_too_and_is_opened_again_when_it_hangs_up(reset: bool) -> None:
    async def answer_once(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(asyncio.IncompleteReadError):  # the last connection is never spoken to
            writer.write((await reader.readexactly(4)).upper())
            await reader.readexactly(3)
            if reset:
                writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        writer.close()
        await writer.wait_closed()
        ended.put_nowait(None)

    ended: asyncio.Queue[None] = asyncio.Queue()
    async with await asyncio.start_server(answer_once, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        async with linked(f"socket://127.0.0.1:{port}") as (link, ears):
            for connection in (1, 2):
                await ears.opening(connection)
                link.write(b"ping")
                await ears.hears(b"PING" * connection)
                link.write(b"bye")
                await ears.loss(connection)
            await ears.opening(3)
        for _ in range(3):
            await ended.get()
    assert ears.events == ["opened", b"PING", "closed", "opened", b"PING", "closed", "opened"]


async def test_a_socket_where_nobody_listens_is_a_clear_problem() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    diary = Diary()
    async with linked(f"socket://127.0.0.1:{port}", diary):
        await diary.written.wait()
    assert diary.entries[0][1]["problem"] == f"Nothing listens at 127.0.0.1, port {port}."


@pytest.mark.usefixtures("impatient")
async def test_a_usb_device_is_found_wherever_it_is_plugged_in(pty: Pty, monkeypatch: pytest.MonkeyPatch) -> None:
    def comports() -> list[ListPortInfo]:
        port = ListPortInfo(pty.slave_path, skip_link_detection=True)
        port.vid, port.pid = 0x2341, 0x0043
        return [port] if pty.plugged else []

    monkeypatch.setattr(list_ports, "comports", comports)
    async with linked("usb:2341:0043") as (_, ears):
        await ears.opening(1)
        pty.unplug()
        await ears.loss(1)
        master, slave = os.openpty()  # may take the name that the device had
        pty.plug()
        await ears.opening(2)
        pty.send(b"here I am")
        await ears.hears(b"here I am")
    os.close(master)
    os.close(slave)


async def test_a_file_is_no_port(tmp_path: Path) -> None:
    (tmp_path / "notes").write_text("no port")
    diary = Diary()
    async with linked(str(tmp_path / "notes"), diary):
        await diary.written.wait()
    assert diary.entries[0][1]["problem"] == f"{tmp_path / 'notes'} is not a serial port."
