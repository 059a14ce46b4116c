"""What could be taken for a new start, or for no change, and is not."""

from __future__ import annotations

from pathlib import Path

from helpers.faulty_board import OTHER_SERIAL, Board
from helpers.faulty_gateway import gateway, unix_offset
from pretouch_sensor_gateway.configuration import DeviceSetting, GatewaySetting

from pretouch.v1 import sensor_gateway_pb2 as pb


async def test_two_boards_of_the_same_boot_number_and_nearly_the_same_clock_are_two_epochs(tmp_path: Path) -> None:
    port = tmp_path / "finger"
    first = Board(port)
    other = Board(port, serial=OTHER_SERIAL, first_tick=2_000_000, sequence=40, plugged=False)
    async with gateway(port) as clients, clients.listening() as listener:
        await clients.opened()
        await first.bursts(6)
        await listener.until(lambda: listener.got == 30)
        await clients.until(lambda status: status.HasField("identity"))
        first.unplug()
        other.plug()
        await clients.opened(2)
        await other.bursts(6)
        await listener.until(lambda: listener.got == 60)
        status = await clients.until(lambda status: status.identity.serial == OTHER_SERIAL)
    assert (status.epoch, listener.lost) == (1, 0)
    assert listener.sequence(1) == list(range(40, 70))
    listener.check_frames({0: 1, 1: 1}, first.times | other.times, unix_offset())


async def test_a_device_whose_clock_stood_still_missed_nobody(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger", first_tick=100_000_000)
    async with gateway(tmp_path / "finger") as clients, clients.listening() as listener:
        await clients.opened()
        await board.bursts(6)
        await listener.until(lambda: listener.got == 30)
        board.clock_leaps(-6_000_000)  # interrupts were off for that long
        board.measure(2, heard=False)
        await board.bursts(6)
        await listener.until(lambda: listener.told >= board.made)
        status = await clients.status()
    assert (status.device.frames, status.device.lost_frames, status.untimed) == (60, 2, 0)
    assert listener.told == board.made


async def test_the_last_frames_before_a_reboot_are_delivered_though_it_comes_at_once(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger")
    async with gateway(tmp_path / "finger") as clients, clients.listening() as listener:
        await clients.opened()
        await board.bursts(6)
        await listener.until(lambda: listener.got == 30)
        with board.at_once():
            board.measure(2)
            board.reboot(first_tick=5)
            board.measure(2)
        await board.bursts(6)
        await listener.until(lambda: listener.told == board.made)
        status = await clients.status()
    assert (listener.got, listener.lost, status.untimed) == (64, 0, 0)


async def test_a_device_that_falls_silent_is_not_blamed_for_a_frame_damaged_before(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger")
    async with gateway(tmp_path / "finger") as clients, clients.listening() as listener:
        await clients.opened()
        board.write(b"\x01\x02\0")
        await board.bursts(6)
        await listener.until(lambda: listener.got == 30)
        board.answers = False
        silent = await clients.until(lambda status: status.device.state == pb.DEVICE_STATE_SILENT)
    assert silent.device.problem.startswith("The port is open, but nothing has arrived for ")


async def test_a_backlog_of_short_lines_is_delivered_whole(tmp_path: Path) -> None:
    board = Board(tmp_path / "finger")
    setting = GatewaySetting((DeviceSetting("finger", str(tmp_path / "finger"), "millimetres"),))
    async with gateway(setting) as clients, clients.listening() as listener:
        await clients.opened()
        board.write(b"\r\n34\r\n")
        await listener.until(lambda: listener.got == 1)
        board.write(b"35\r\n" * 1000)
        await listener.until(lambda: listener.told == 1001)
        status = await clients.status()
    assert (listener.got, listener.lost, status.untimed) == (1001, 0, 0)
