"""Subscribers that do not read, and subscribers that come and go: each is told what it missed, and none stays."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

import numpy as np
from helpers.faulty_board import Board
from helpers.faulty_gateway import Gateway, client, gateway, small_window, unix_offset
from helpers.faulty_listener import Account, Listener
from helpers.links import eventually
from pretouch_sensor_gateway.subscription_queue import QUEUE_MEASUREMENTS

from pretouch.v1 import sensor_gateway_pb2 as pb

MODULES = 64
"""Frames are as large as can be, so that the windows of gRPC fill soon."""


async def test_one_that_stops_reading_is_told_its_losses_and_another_loses_nothing(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger", modules=MODULES)
    async with (
        gateway(tmp_path / "finger") as clients,
        clients.listening() as quick,
        small_window(clients.port) as idle,
        idle.listening() as slow,
    ):
        await clients.opened()
        await board.bursts(2)
        await slow.until(lambda: slow.got == 10)
        slow.reads.clear()
        overrun = 0
        while overrun < QUEUE_MEASUREMENTS:
            await board.bursts(10, frames=10)
            overrun = (await clients.status()).overrun
        slow.reads.set()
        await board.bursts(2)
        await quick.until(lambda: quick.got == board.made)
        await slow.until(lambda: slow.told == board.made)
        status = await clients.status()
    assert (quick.lost, quick.overrun) == (0, 0)
    assert slow.lost == 0
    assert status.overrun == slow.overrun >= QUEUE_MEASUREMENTS
    assert slow.got + slow.overrun == board.made
    assert quick.sequence() == list(range(board.made))
    for listener in (quick, slow):
        listener.check_gaps()
        listener.check_frames({0: 1}, board.times, unix_offset())


async def test_losses_on_the_line_and_in_the_queue_are_each_told_once(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger", modules=MODULES)
    async with (
        gateway(tmp_path / "finger") as clients,
        clients.listening() as quick,
        small_window(clients.port) as idle,
        idle.listening() as slow,
    ):
        await clients.opened()
        await board.bursts(2)
        await slow.until(lambda: slow.got == 10)
        slow.reads.clear()
        while (await clients.status()).overrun < QUEUE_MEASUREMENTS:
            for _ in range(10):
                board.measure(1, heard=False)
                await board.bursts(1, frames=9)
        slow.reads.set()
        await board.bursts(2)
        await quick.until(lambda: quick.told == board.made)
        await slow.until(lambda: slow.told == board.made)
    assert quick.overrun == 0
    assert quick.lost > slow.lost > 0
    assert slow.got + slow.lost + slow.overrun == quick.got + quick.lost == board.made
    quick.check_gaps()
    slow.check_gaps()


async def a_while(clients: Gateway, rng: np.random.Generator) -> Account:
    """Listens for a random number of answers and leaves, in one way or another."""
    answers = int(rng.integers(0, 60))
    stream = clients.stub.StreamRanges(pb.StreamRangesRequest())
    if not answers:  # not even the beginning
        await asyncio.sleep(0)
        stream.cancel()
        return Account()
    await stream.wait_for_connection()
    async with Listener(stream) as listener:
        await listener.until(lambda: len(listener.answers) >= answers)
        if rng.random() < 0.3:  # and leaves what comes from now on unread
            listener.reads.clear()
            await asyncio.sleep(0.05 * rng.random())
    return listener


def descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


async def test_a_hundred_that_come_and_go_each_see_all_of_their_time_and_leave_nothing_behind(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    board = Board(tmp_path / "finger", modules=6)
    accounts: list[Account] = []
    async with gateway(tmp_path / "finger") as clients:
        await clients.opened()
        measuring = asyncio.create_task(measure_with_gaps(board, rng))
        async with clients.listening() as first:  # what gRPC opens once for all is open
            await first.until(lambda: first.got > 20)
        await clients.until(lambda status: not status.subscribers)
        tasks, files = len(asyncio.all_tasks()), descriptors()

        async def come_and_go(visits: int) -> None:
            for _ in range(visits):
                await asyncio.sleep(0.05 * rng.random())
                accounts.append(await a_while(clients, rng))

        async with asyncio.TaskGroup() as visitors:
            for _ in range(20):
                visitors.create_task(come_and_go(5))
        after = await clients.until(lambda status: not status.subscribers)
        await eventually(lambda: len(asyncio.all_tasks()) <= tasks and descriptors() <= files)
        made = board.made
        await eventually(lambda: board.made >= made + 100)
        assert (await clients.status()).overrun == after.overrun
        measuring.cancel()
    assert len(accounts) == 100
    heard = [account for account in accounts if account.answers]
    assert len(heard) > 80
    assert sum(account.lost for account in heard) > 0
    for account in heard:
        account.check_gaps()
        account.check_frames({0: 1}, board.times, unix_offset())
        first_answer, *rest = account.answers
        span = account.sequence()[-1] - account.sequence()[first_answer.batch.t.shape[0] - 1]
        assert span == sum(answer.batch.t.shape[0] + answer.batch.lost + answer.overrun for answer in rest)


async def measure_with_gaps(board: Board, rng: np.random.Generator) -> None:
    """Bursts, and now and then a measurement that is lost on the line."""
    while True:
        await board.bursts(1, frames=2)
        if rng.random() < 0.1:
            board.measure(1, heard=False)


async def test_a_client_whose_connection_breaks_is_forgotten(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger")
    async with gateway(tmp_path / "finger") as clients:
        await clients.opened()
        measuring = asyncio.create_task(board.measure_on())
        for _ in range(5):
            async with client(clients.port) as broken:
                stream = broken.stub.StreamRanges(pb.StreamRangesRequest())
                assert (await stream.read()).batch.t.shape[0]  # and the channel is closed over the open call
        await clients.until(lambda status: not status.subscribers)
        measuring.cancel()
