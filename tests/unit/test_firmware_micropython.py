"""The MicroPython example speaks the binary format; run by this Python, with stand-ins for the board."""

from __future__ import annotations

import importlib.util
import math
import os
import select
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pretouch_sensor_gateway.wire_formats.binary import FrameDecoder, encode
from pretouch_sensor_gateway.wire_formats.messages import Identify, Message, Ping
from pretouch_sensor_gateway.wire_formats.parser import Identity, Measurement, PingReply

EXAMPLE = Path(__file__).parents[2] / "firmware/micropython/finger.py"
TICKS = 2**30


class Ticks:
    """A board's clock in microseconds, which wraps at 2^30."""

    def __init__(self) -> None:
        self.now = TICKS - 50

    def ticks_us(self) -> int:
        return self.now % TICKS

    def ticks_diff(self, later: int, earlier: int) -> int:
        return (later - earlier + TICKS // 2) % TICKS - TICKS // 2

    def ticks_add(self, ticks: int, by: int) -> int:
        return (ticks + by) % TICKS


class Board:
    """The example's module, and the two ends of its USB."""

    def __init__(self, module: ModuleType, clock: Ticks) -> None:
        self.module: Any = module
        self.clock = clock
        self.frames = FrameDecoder()
        (far_in, self._to_board), (self._from_board, far_out) = os.pipe(), os.pipe()
        self.source, self.sink = os.fdopen(far_in, "rb", buffering=0), os.fdopen(far_out, "wb", buffering=0)

    def finger(self, modules: int = 2) -> Any:
        return self.module.Finger(modules, 50_000, self.source, self.sink)

    def write(self, data: bytes) -> None:
        os.write(self._to_board, data)

    def said(self) -> list[Message]:
        data = b""
        while select.select([self._from_board], [], [], 0)[0]:
            data += os.read(self._from_board, 65536)
        return self.frames.feed(data)

    def close(self) -> None:
        self.source.close()
        self.sink.close()
        os.close(self._to_board)
        os.close(self._from_board)


@pytest.fixture
def board(monkeypatch: pytest.MonkeyPatch) -> Iterator[Board]:
    clock = Ticks()
    for name in ("ticks_us", "ticks_diff", "ticks_add"):
        monkeypatch.setattr(time, name, getattr(clock, name), raising=False)
    machine = SimpleNamespace(unique_id=lambda: b"\x01\x02\x03\x04\x05\x06", WDT=lambda timeout: None)
    monkeypatch.setitem(sys.modules, "machine", machine)  # type: ignore[arg-type]
    monkeypatch.setitem(sys.modules, "micropython", SimpleNamespace())  # type: ignore[arg-type]
    described = importlib.util.spec_from_file_location("finger", EXAMPLE)
    assert described is not None
    assert described.loader is not None
    module = importlib.util.module_from_spec(described)
    described.loader.exec_module(module)
    board = Board(module, clock)
    yield board
    board.close()


def test_it_says_who_it_is_and_measures_in_the_boards_time(board: Board) -> None:
    finger = board.finger()
    for k in range(3):
        board.clock.now += 50_000

        def measure() -> list[tuple[int | None, int]]:
            board.clock.now += 1000
            return [(345, 0), (None, 7)]

        finger.measure(measure)
        assert finger.sequence == k + 1
    identity, *measurements = board.said()
    assert isinstance(identity, Identity)
    assert (identity.serial, identity.modules) == ("0102030405060000", 2)
    assert identity.period == pytest.approx(0.05)
    assert all(isinstance(measurement, Measurement) for measurement in measurements)
    first, second, third = (m for m in measurements if isinstance(m, Measurement))
    assert first.ranges[0] == pytest.approx(0.0345)
    assert math.isnan(first.ranges[1])
    assert first.status == (0, 7)
    assert (first.micros, second.micros, third.micros) == (50_500, 101_500, 152_500)  # through the wrap of its ticks
    assert first.boot == identity.boot
    assert not board.frames.refused


def test_it_answers_pings_and_identifies_amid_garbage(board: Board) -> None:
    finger = board.finger()
    board.said()
    board.write(b"\x03garbage of any length, longer than any request\0\0\xff\0")
    board.write(encode(Ping(2**32 - 1)) + encode(Identify()) + encode(Ping(0)))
    board.clock.now += 700
    finger.serve()
    first, identity, second = board.said()
    assert (first, second) == (PingReply(finger.boot, 2**32 - 1, 700), PingReply(finger.boot, 0, 700))
    assert isinstance(identity, Identity)


@given(st.binary(max_size=40))
def test_its_frames_are_the_gateways_and_no_bytes_do_it_harm(message: bytes) -> None:
    finger = _plain_module()
    frame = finger.encode(message)
    assert frame.count(0) == 1
    assert finger.decode(frame[:-1]) == message
    assert finger.decode(message) is None or len(message) > 2


def _plain_module() -> Any:
    """The example's functions alone."""
    names: dict[str, Any] = {}
    source = EXAMPLE.read_text().replace("import machine\nimport micropython\n", "")
    exec(compile(source, str(EXAMPLE), "exec"), names)
    return SimpleNamespace(**names)
