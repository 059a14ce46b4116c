"""The gateway on a bad line: what a board sent is what a subscriber got and what it was told to be lost.

The service, its port and its calls are real; the device end of the port is a board of the test's.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.faulty_board import PAUSE, Board, whole
from helpers.faulty_gateway import gateway, unix_offset
from pretouch_sensor_gateway.configuration import DeviceSetting, GatewaySetting
from pretouch_sensor_gateway.transport import reconnection

from benchmarks.virtual_finger import flip_bits
from pretouch.v1 import sensor_gateway_pb2 as pb

ONE_BOOT = {0: 1}
BANNER = b"\r\nOptiboot 8.0 115200\r\n\r\nflash: 0x7e00\r\nPress any key to stop autoboot: 3 2 1 0\r\n"


async def in_two(board: Board, data: bytes, cut: int) -> None:
    """What a read may well take in two."""
    board.write(data[:cut])
    await board.written()
    await asyncio.sleep(PAUSE)
    board.write(data[cut:])


async def test_unplugged_amid_a_frame_and_plugged_in_again_the_stream_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reconnection, "STEADY_AFTER", 0.0)  # else what happens within ten seconds is one outage
    board = Board(tmp_path / "finger", modules=6)
    cuts = (1, 2, 5, 17, 34, 35)
    async with gateway(tmp_path / "finger") as clients, clients.listening() as listener:
        await clients.opened()
        await board.bursts(10)
        await listener.until(lambda: listener.got == 50)
        for outage, cut in enumerate(cuts, start=1):
            frame = board.frame()
            assert len(frame) == 35  # the last cut is behind its whole
            board.write(frame[:cut])
            await board.written()
            if outage % 2:
                await asyncio.sleep(PAUSE)  # else what nobody has read yet goes with the line
            board.unplug()
            await clients.until(lambda status: status.device.state == pb.DEVICE_STATE_CONNECTING)
            board.measure(20)  # to nobody
            if outage == 1:
                await asyncio.sleep(3 * reconnection.FIRST_DELAY)  # so that it is tried in vain
            board.plug()
            await clients.opened(1 + outage)
            before = listener.got
            await in_two(board, board.frame(), cut)
            await board.bursts(4)
            await listener.until(lambda known=before: listener.got >= known + 21)  # type: ignore[misc]
        status = await clients.status()
    assert listener.told == board.made == 50 + len(cuts) * 42
    assert listener.overrun == 0
    assert len(cuts) * 20 <= listener.lost <= len(cuts) * 21
    assert status.device.lost_frames == listener.lost
    assert status.device.frames == listener.got
    assert (status.epoch, status.untimed, dict(status.refused)) == (0, 0, {})
    assert status.connections == 1 + len(cuts)
    assert clients.warnings() == ["the port failed; trying again until it works"] * len(cuts)
    listener.check_gaps()
    listener.check_frames(ONE_BOOT, board.times, unix_offset())


async def test_a_board_that_comes_and_goes_while_nobody_waits_for_it_adds_up(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger")
    async with gateway(tmp_path / "finger") as clients, clients.listening() as listener:
        await clients.opened()
        await board.bursts(2)
        for _ in range(8):
            board.measure(7)
            board.write(board.frame()[:9])
            board.unplug()
            board.measure(3)
            board.plug()
        opened = (await clients.status()).connections
        await board.bursts(2)
        await clients.opened(opened + 1)
        await board.bursts(4)
        await listener.until(lambda: listener.told == board.made)
    assert clients.warnings() == ["the port failed; trying again until it works"]
    listener.check_gaps()
    listener.check_frames(ONE_BOOT, board.times, unix_offset())


async def test_one_percent_of_flipped_bits_costs_the_frames_they_hit(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    board = Board(tmp_path / "finger")
    async with gateway(tmp_path / "finger") as clients, clients.listening() as listener:
        await clients.opened()
        await board.bursts(4)
        await listener.until(lambda: listener.got == 20)
        board.damage = lambda data: flip_bits(data, 0.01, rng)
        await board.bursts(300, frames=10)
        board.damage = whole
        board.write(b"\0")
        await board.bursts(4)
        await listener.until(lambda: listener.told == board.made)
        status = await clients.status()
    assert board.made == 3040
    assert board.damaged > 1500
    assert sum(status.refused.values()) == status.device.bad_frames == board.damaged
    assert listener.lost == status.device.lost_frames > 1500
    assert listener.got == status.device.frames > 300
    assert (status.epoch, status.untimed, listener.overrun) == (0, 0, 0)
    listener.check_gaps()
    listener.check_frames(ONE_BOOT, board.times, unix_offset())


def garbage(rng: np.random.Generator) -> bytes:
    return rng.bytes(int(rng.integers(1, 4000)))


def oversize(rng: np.random.Generator) -> bytes:
    return rng.integers(1, 256, int(rng.integers(209, 1000))).astype(np.uint8).tobytes() + b"\0"


def endless(rng: np.random.Generator) -> bytes:
    return rng.integers(1, 256, 20_000).astype(np.uint8).tobytes()


def zeros(rng: np.random.Generator) -> bytes:
    return bytes(int(rng.integers(1, 10_000)))


def banner(rng: np.random.Generator) -> bytes:
    return BANNER[: rng.integers(1, len(BANNER))] + b"\0"


@pytest.mark.parametrize("noise", [garbage, oversize, endless, zeros, banner])
async def test_noise_costs_no_more_than_the_frame_it_runs_into(
    noise: Callable[[np.random.Generator], bytes], tmp_path: Path
) -> None:
    rng = np.random.default_rng(2)
    board = Board(tmp_path / "finger")
    async with gateway(tmp_path / "finger") as clients, clients.listening() as listener:
        await clients.opened()
        await board.bursts(4)
        for _ in range(12):
            board.write(noise(rng))
            await board.bursts(2, frames=3)
        await listener.until(lambda: listener.told == board.made)
        status = await clients.status()
    assert listener.lost <= 12
    assert listener.lost == (0 if noise in (zeros, oversize, banner) else status.device.lost_frames)
    assert sum(status.refused.values()) == board.damaged
    assert (board.damaged == 0) == (noise is zeros)
    listener.check_gaps()
    listener.check_frames(ONE_BOOT, board.times, unix_offset())


async def test_a_frame_that_comes_twice_counts_once(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger")
    async with gateway(tmp_path / "finger") as clients, clients.listening() as listener:
        await clients.opened()
        await board.bursts(4)
        for _ in range(10):
            board.write(2 * board.frame())
            await board.bursts(1, frames=1)
        await listener.until(lambda: listener.told == board.made)
        status = await clients.status()
    assert (listener.got, listener.lost, status.epoch) == (40, 0, 0)
    assert dict(status.refused) == {"implausible": 10}
    assert listener.sequence() == list(range(40))
    listener.check_frames(ONE_BOOT, board.times, unix_offset())


async def test_half_frames_are_refused_and_counted_as_lost(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger", modules=6)
    async with gateway(tmp_path / "finger") as clients, clients.listening() as listener:
        await clients.opened()
        await board.bursts(4)
        halves = 0
        for cut in range(1, 34):
            board.write(board.frame()[:cut] + b"\0")
            await board.bursts(1, frames=1)
            halves += 1
        await listener.until(lambda: listener.told == board.made)
        status = await clients.status()
    assert (listener.got, listener.lost) == (20 + halves, halves)
    assert sum(status.refused.values()) == board.damaged == halves
    listener.check_frames(ONE_BOOT, board.times, unix_offset())


async def test_a_boot_loader_that_speaks_first_hides_no_frame(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    board = Board(tmp_path / "finger")
    async with gateway(tmp_path / "finger") as clients, clients.listening() as listener:
        await clients.opened()
        board.write(BANNER + rng.bytes(500) + BANNER + b"\0")
        await board.bursts(4)
        await listener.until(lambda: listener.told == board.made)
        status = await clients.status()
    assert status.format == "binary"
    assert (listener.got, listener.lost) == (20, 0)
    assert sum(status.refused.values()) == board.damaged > 0


async def test_a_device_that_floods_the_gateway_keeps_no_other_from_being_heard(tmp_path: Path) -> None:
    noise = np.random.default_rng(6).bytes(4096)
    board = Board(tmp_path / "finger")
    flood = Board(tmp_path / "flood")
    setting = GatewaySetting(
        (DeviceSetting("finger", str(tmp_path / "finger")), DeviceSetting("flood", str(tmp_path / "flood"), "binary"))
    )

    async def flooding() -> None:
        while True:
            flood.write(noise)
            await flood.written()

    async with gateway(setting, "finger") as clients, clients.listening() as listener:
        await clients.opened()
        pouring = asyncio.create_task(flooding())
        await board.bursts(100)
        await listener.until(lambda: listener.got == board.made)
        status = await clients.status()
        pouring.cancel()
    assert len(flood.line) > 100 * len(noise)
    assert (listener.lost, listener.overrun, status.device.bad_frames) == (0, 0, 0)


async def test_a_device_that_stalls_is_silent_and_then_goes_on(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger")
    async with gateway(tmp_path / "finger") as clients, clients.listening() as listener:
        await clients.opened()
        await board.bursts(4)
        await listener.until(lambda: listener.got == 20)
        board.answers = False
        silent = await clients.until(lambda status: status.device.state == pb.DEVICE_STATE_SILENT)
        assert silent.device.problem.startswith("The port is open, but nothing has arrived for ")
        board.answers = True
        await board.bursts(4)
        await listener.until(lambda: listener.got == board.made)
        again = await clients.until(lambda status: status.device.state == pb.DEVICE_STATE_STREAMING)
    assert again.device.problem == ""
    assert (listener.got, listener.lost, listener.overrun) == (40, 0, 0)
    assert (again.epoch, again.connections, again.device.bad_frames) == (0, 1, 0)
    assert clients.warnings() == []
    listener.check_frames(ONE_BOOT, board.times, unix_offset())
