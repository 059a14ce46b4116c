"""The fingertip's firmware behind a pseudo-terminal, in real time, as a serial port of the gateway's machine."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import serial
from helpers.firmware_bench import MODULES, Bench, make, need, sanitizers
from pretouch_sensor_gateway.wire_formats.binary import FrameDecoder, encode
from pretouch_sensor_gateway.wire_formats.messages import Identify, Message, Ping
from pretouch_sensor_gateway.wire_formats.parser import Identity, Measurement, PingReply

BAUD = 115200
TIMEOUT = 60.0  # of each read: only a hang takes so long


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    need("make", "cc")
    build = tmp_path_factory.mktemp("port")
    make(f"{build}/finger-host", build, **sanitizers(build))
    return build / "finger-host"


@pytest.fixture
def bench(program: Path) -> Iterator[Bench]:
    with Bench(program) as bench:
        yield bench


class Line:
    """The gateway's end of the line."""

    def __init__(self, bench: Bench) -> None:
        self.frames = FrameDecoder()
        self._port = serial.Serial(bench.port, BAUD, timeout=TIMEOUT)
        self._messages: list[Message] = []

    def next(self, *kinds: type[Message]) -> Message:
        """The next message of one of `kinds`; those before are dropped."""
        while True:
            while self._messages:
                message = self._messages.pop(0)
                if isinstance(message, kinds):
                    return message
            data = self._port.read(max(1, self._port.in_waiting))
            assert data, "the board fell silent"
            self._messages += self.frames.feed(data)

    def measurements(self, count: int) -> list[Measurement]:
        found = [self.next(Measurement) for _ in range(count)]
        return [message for message in found if isinstance(message, Measurement)]

    def write(self, data: bytes) -> None:
        self._port.write(data)

    def __enter__(self) -> Line:
        return self

    def __exit__(self, *_: object) -> None:
        self._port.close()


def test_ranges_come_through_the_port_without_gap_or_refusal(bench: Bench) -> None:
    for k in range(MODULES):
        bench.tell(f"see {k} {20 + k} 0")
    with Line(bench) as line:
        line.next(Measurement)  # whoever joins in the middle of a frame is in step at the next
        line.frames.refused.clear()
        measurements = line.measurements(20)
        assert not line.frames.refused
    sequences = [measurement.sequence or 0 for measurement in measurements]
    assert sequences == list(range(sequences[0], sequences[0] + 20))
    assert measurements[-1].ranges == pytest.approx([(20 + k) * 1e-3 for k in range(MODULES)])


def test_pings_and_identifies_are_answered_through_the_port(bench: Bench) -> None:
    with Line(bench) as line:
        line.next(Measurement)
        for sequence in (1, 2**32 - 1, 7):
            line.write(encode(Ping(sequence)))
            reply = line.next(PingReply)
            assert isinstance(reply, PingReply)
            assert reply.sequence == sequence
        line.write(encode(Identify()))
        identity = line.next(Identity)
        assert isinstance(identity, Identity)
        assert identity.modules == MODULES


def test_a_reboot_with_the_port_open(bench: Bench) -> None:
    with Line(bench) as line:
        (before,) = line.measurements(1)
        bench.tell("reboot")
        identity = line.next(Identity)
        assert isinstance(identity, Identity)
        assert identity.boot == (before.boot or 0) + 1
        (first,) = line.measurements(1)
        assert (first.boot, first.sequence) == (identity.boot, 0)


def test_what_is_sent_while_nobody_listens_is_lost_not_kept(bench: Bench) -> None:
    with Line(bench) as line:
        (last,) = line.measurements(1)
    start = bench.tell("state")["micros"]
    while bench.tell("state")["micros"] < start + 500_000:
        pass
    with Line(bench) as line:
        (first,) = line.measurements(1)
    assert (first.sequence or 0) - (last.sequence or 0) >= 10


def test_time_cannot_be_run_where_it_runs_by_itself(bench: Bench) -> None:
    with pytest.raises(AssertionError, match="no such command"):
        bench.tell("run 10")
