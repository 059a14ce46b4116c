"""The gateway when a board starts anew or another one sits on its line: nothing is mixed, and the counts add up."""

from __future__ import annotations

import asyncio
from pathlib import Path

from helpers.faulty_board import FIRST_SERIAL, OTHER_SERIAL, PAUSE, Board
from helpers.faulty_gateway import gateway, unix_offset
from pretouch_sensor_gateway.calibration import file
from pretouch_sensor_gateway.calibration.model import Calibration, ModuleCalibration
from pretouch_sensor_gateway.configuration import VARIABLE, GatewaySetting, load_configuration

from pretouch.v1 import sensor_gateway_pb2 as pb

LONG_AGO = 100_000
"""Measurements of a board that has run for minutes."""


async def test_another_board_on_the_same_port_is_an_epoch_of_its_own(tmp_path: Path) -> None:
    port = tmp_path / "finger"
    first = Board(port, boot=7, sequence=LONG_AGO, first_tick=3_000_000_000)
    other = Board(port, boot=99, sequence=5 * LONG_AGO, first_tick=17, serial=OTHER_SERIAL, modules=2, plugged=False)
    async with gateway(port) as clients, clients.listening() as listener:
        await clients.opened()
        await first.bursts(6)
        await listener.until(lambda: listener.got == 30)
        assert (await clients.until(lambda status: status.HasField("identity"))).identity.serial == FIRST_SERIAL
        first.unplug()
        first.skip(50)
        other.plug()
        await clients.opened(2)
        await other.bursts(6)
        await listener.until(lambda: listener.got == 60)
        there = await clients.until(lambda status: status.identity.serial == OTHER_SERIAL)
        assert (there.epoch, there.identity.modules) == (1, 2)
        other.unplug()
        other.skip(50)
        first.skip(50)
        first.plug()
        await clients.opened(3)
        await first.bursts(6)
        await listener.until(lambda: listener.got == 90)
        back = await clients.until(lambda status: status.identity.serial == FIRST_SERIAL)
    assert first.made + other.made == listener.got == back.device.frames == 90
    assert (back.device.lost_frames, back.untimed, listener.lost, listener.overrun) == (0, 0, 0, 0)
    assert (back.epoch, back.connections, dict(back.refused)) == (2, 3, {})
    assert listener.epochs() == [0, 1, 2]
    assert listener.sequence(0) == list(range(LONG_AGO, LONG_AGO + 30))
    assert listener.sequence(1) == list(range(5 * LONG_AGO, 5 * LONG_AGO + 30))
    assert listener.sequence(2) == list(range(LONG_AGO + 130, LONG_AGO + 160))
    assert [len(batch.range.shape) and batch.range.shape[1] for batch in listener.batches if batch.epoch == 1] == [
        2
    ] * sum(batch.epoch == 1 for batch in listener.batches)
    listener.check_frames({0: 7, 1: 99, 2: 7}, first.times | other.times, unix_offset())


async def test_boards_of_other_formats_take_turns_on_one_port(tmp_path: Path) -> None:
    port = tmp_path / "finger"
    binary = Board(port, sequence=LONG_AGO)
    text = Board(port, plugged=False)
    async with gateway(port) as clients, clients.listening() as listener:
        await clients.opened()
        await binary.bursts(6)
        await listener.until(lambda: listener.got == 30)
        binary.unplug()
        text.plug()
        await clients.opened(2)
        for count in range(31):
            text.write(b"d1: %d mm d2: %d mm\r\n" % (30 + count * 7 % 11, 40 + count * 5 % 13))
            await asyncio.sleep(2 * PAUSE)
        await listener.until(lambda: listener.told == 60)  # the first line may have been the rest of a longer one
        there = await clients.status()
        assert (there.format, there.epoch, there.device.lost_frames) == ("d1: {range:mm} mm d2: {range:mm} mm", 1, 0)
        assert dict(there.refused) == {"fields": 1}
        assert listener.lost == there.untimed <= 12
        text.unplug()
        binary.skip(500)
        binary.plug()
        await clients.opened(3)
        await binary.bursts(6)
        await listener.until(lambda: listener.told == 90)
        back = await clients.until(lambda status: status.HasField("identity"))
    assert (back.format, back.epoch, back.untimed) == ("binary", 2, there.untimed)
    assert text.asked == b""
    assert listener.epochs() == [0, 1, 2]
    assert listener.sequence(0) + listener.sequence(2) == sorted(number for _, number in binary.times)
    assert listener.sequence(1) == list(range(30 - there.untimed))


def pinned(folder: Path, port: Path, serial: str) -> GatewaySetting:
    """A configuration file whose device is calibrated for the board of that serial only, and what it says."""
    file.save(folder / "finger.json", Calibration(serial, 0.0, (ModuleCalibration(offset=0.001),)))
    (folder / "gateway.toml").write_text(
        f'[devices.finger]\naddress = "{port}"\ncalibration = "finger.json"\nformat = "binary"\n'
    )
    return load_configuration({VARIABLE: str(folder / "gateway.toml")})


async def test_a_board_that_is_not_the_calibrated_one_is_refused_until_that_is_back(tmp_path: Path) -> None:
    port = tmp_path / "finger"
    first = Board(port, boot=7, sequence=LONG_AGO)
    other = Board(port, boot=99, sequence=5 * LONG_AGO, serial=OTHER_SERIAL, plugged=False)
    async with gateway(pinned(tmp_path, port, FIRST_SERIAL)) as clients, clients.listening() as listener:
        await clients.opened()
        await first.bursts(6)
        await listener.until(lambda: listener.got == 30)
        first.unplug()
        other.plug()
        await clients.opened(2)
        measuring = asyncio.create_task(other.measure_on())
        refused = await clients.until(lambda status: status.refused["foreign"] >= 100 and status.device.problem != "")
        measuring.cancel()
        assert FIRST_SERIAL in refused.device.problem
        assert OTHER_SERIAL in refused.device.problem
        await other.written()
        await clients.until(lambda status: status.refused["foreign"] == other.made)
        assert listener.got == 30
        other.unplug()
        first.skip(500)
        first.plug()
        await clients.opened(3)
        await first.bursts(6)
        await listener.until(lambda: listener.got == 60)
        back = await clients.until(lambda status: status.identity.serial == FIRST_SERIAL)
    assert back.device.problem == ""
    assert listener.got == back.device.frames == first.made
    assert (listener.lost, listener.overrun, back.untimed) == (0, 0, 0)
    assert dict(back.refused) == {"foreign": other.made}
    assert listener.epochs() == [0, 2]
    listener.check_frames({0: 7, 2: 7}, first.times, unix_offset())


async def test_a_reboot_is_a_new_epoch_that_tells_what_nobody_heard(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger", sequence=1000, first_tick=123_456_789)
    async with gateway(tmp_path / "finger") as clients, clients.listening() as listener:
        await clients.opened()
        await board.bursts(10)
        board.reboot(first_tick=2_000_000_000)
        await asyncio.sleep(0.01)
        board.measure(5, heard=False)
        await board.bursts(10)
        await listener.until(lambda: listener.told == board.made)
        status = await clients.until(lambda status: status.HasField("identity"))
    assert board.made == 105
    assert (listener.got, listener.lost, listener.overrun) == (100, 5, 0)
    assert (status.device.frames, status.device.lost_frames) == (100, 5)
    assert (status.epoch, status.connections, status.untimed, dict(status.refused)) == (1, 1, 0, {})
    assert status.identity.serial == FIRST_SERIAL
    assert listener.sequence(0) == list(range(1000, 1050))
    assert listener.sequence(1) == list(range(5, 55))
    listener.check_gaps()
    listener.check_frames({0: 1, 1: 2}, board.times, unix_offset())


async def test_reboots_shortly_after_one_another_add_up(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger", first_tick=4_000_000_000)
    async with gateway(tmp_path / "finger") as clients, clients.listening() as listener:
        await clients.opened()
        for start in range(6):
            await board.bursts(3)
            board.reboot(first_tick=500_000_000 * start)
        await board.bursts(3)
        await listener.until(lambda: listener.told == board.made)
        status = await clients.status()
    assert board.made == 7 * 15 == status.device.frames + status.device.lost_frames + status.untimed
    assert (status.epoch, dict(status.refused), listener.overrun) == (6, {}, 0)
    listener.check_frames({epoch: epoch + 1 for epoch in range(7)}, board.times, unix_offset())


async def test_what_was_measured_before_any_ping_was_answered_is_told_as_lost(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger", answers=False)
    async with gateway(tmp_path / "finger") as clients, clients.listening() as listener:
        await clients.opened()
        await board.bursts(4)
        await clients.until(lambda status: status.device.state == pb.DEVICE_STATE_STREAMING)
        await board.bursts(60)
        held = await clients.until(lambda status: status.untimed == 320 - 256)  # the oldest of more than it holds
        assert not held.clock.synchronised
        board.reboot(first_tick=77)
        board.answers = True
        await board.bursts(4)
        await listener.until(lambda: listener.told == board.made)
        status = await clients.status()
    assert (board.made, listener.got, listener.lost) == (340, 20, 320)
    assert (status.device.frames, status.untimed, status.device.lost_frames) == (20, 320, 0)
    assert listener.epochs() == [1]
    listener.check_frames({1: 2}, board.times, unix_offset())
