"""A port that the gateway may not have at first: it says why, warns once, and takes it when it is free."""

from __future__ import annotations

import asyncio
import os
import sys
from asyncio.subprocess import PIPE
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from helpers.faulty_board import Board
from helpers.faulty_gateway import Gateway, gateway, unix_offset
from pretouch_sensor_gateway.transport.reconnection import FIRST_DELAY

from pretouch.v1 import sensor_gateway_pb2 as pb

HOLDER = """
import sys, serial
port = serial.Serial(sys.argv[1], exclusive=True)
print("held", flush=True)
sys.stdin.read()
"""
NOBODY = 65534


async def refused(clients: Gateway) -> str:
    """Why the port cannot be opened, once that was found."""
    status = await clients.until(lambda status: status.device.problem != "")
    assert (status.device.state, status.connections) == (pb.DEVICE_STATE_CONNECTING, 0)
    await asyncio.sleep(3 * FIRST_DELAY)  # so that it is tried again in vain
    return status.device.problem


async def check_that_it_works(board: Board, clients: Gateway) -> None:
    await clients.opened()
    async with clients.listening() as listener:
        await board.bursts(10)
        await listener.until(lambda: listener.got == board.made)
    status = await clients.until(lambda status: status.device.problem == "")
    assert status.device.state == pb.DEVICE_STATE_STREAMING
    assert (listener.got, listener.lost, listener.overrun) == (50, 0, 0)
    assert clients.warnings() == ["the port failed; trying again until it works"]
    listener.check_frames({0: 1}, board.times, unix_offset())


async def test_a_port_that_another_program_holds_is_taken_when_that_ends(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger")
    holder = await asyncio.create_subprocess_exec(
        *(sys.executable, "-c", HOLDER, str(tmp_path / "finger")), stdin=PIPE, stdout=PIPE
    )
    assert holder.stdin is not None
    assert holder.stdout is not None
    assert await holder.stdout.readline() == b"held\n"
    async with gateway(tmp_path / "finger") as clients:
        problem = await refused(clients)
        assert problem.startswith(f"Another program or device entry holds {tmp_path / 'finger'}: `fuser -v")
        holder.stdin.close()
        assert await holder.wait() == 0
        await check_that_it_works(board, clients)


@contextmanager
def as_nobody() -> Iterator[None]:
    """Without the rights of root, who may open everything; any other user stays who they are."""
    root = os.geteuid() == 0
    if root:
        os.seteuid(NOBODY)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)


async def test_a_port_that_the_user_may_not_open_is_taken_once_they_may(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger")
    device = (tmp_path / "finger").resolve()
    device.chmod(0)
    with as_nobody():
        with pytest.raises(PermissionError):
            device.open("rb", buffering=0)
        async with gateway(device) as clients:
            problem = await refused(clients)
            assert problem.startswith(f"The gateway's user may not open {device}, which belongs to the group ")
            if os.getuid() == 0:
                os.seteuid(0)
            device.chmod(0o666)
            if os.getuid() == 0:
                os.seteuid(NOBODY)
            await check_that_it_works(board, clients)
