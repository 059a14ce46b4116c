"""What well-known boards and sketches print is read right, or refused with the reason; the cases are made in code."""

from __future__ import annotations

import math
import re
import time

import numpy as np
import pytest
import structlog
from pretouch_sensor_gateway.range_batch import RangeBatch
from pretouch_sensor_gateway.serial_source import SerialSource
from pretouch_sensor_gateway.source import DeviceState, SourceStatus
from pretouch_sensor_gateway.transport.reconnection import LinkState
from pretouch_sensor_gateway.wire_formats.auto_detection import AUTO
from pretouch_sensor_gateway.wire_formats.diagnosis import explain
from pretouch_sensor_gateway.wire_formats.parser import Measurement, Parser
from pretouch_sensor_gateway.wire_formats.registry import create_parser
from pretouch_sensor_gateway.wire_formats.text import Modules

from benchmarks.board_cases import CASES, BoardCase

STEP = {"mm": 0.51, "cm": 5.1, "m": 5.1}
"""Millimetres by which a sensor that prints whole millimetres, centimetres or 0.01 m is off, and no more."""
BAUD = 115_200


def read(case: BoardCase, asked: str) -> tuple[list[Measurement], Parser]:
    parser = create_parser(asked, Modules(case.modules))
    return [message for message in parser.feed(case.data) if isinstance(message, Measurement)], parser


def check_first_module(case: BoardCase, measured: list[Measurement], unit: str) -> None:
    """Each measurement is a true one, in their order; what had no target has no range."""
    truth = iter(case.truth)
    for measurement in measured:
        metres = measurement.ranges[0]
        fits = (
            value is None if math.isnan(metres) else value is not None and abs(value - metres * 1000) <= STEP[unit]
            for _, value in truth
        )
        assert any(fits), f"{metres} m is no true range, or out of order"


@pytest.mark.parametrize("case", [case for case in CASES if case.readable], ids=lambda case: case.name)
def test_a_board_whose_format_is_named_is_read_right(case: BoardCase) -> None:
    measured, parser = read(case, case.named)
    assert len(measured) > 0.45 * len(case.truth)  # a module is unplugged, or a program ends, in the middle
    check_first_module(case, measured, parser.unit)
    if case.modules is not None:
        assert {len(measurement.ranges) for measurement in measured} == {case.modules}


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_auto_reads_a_board_right_or_asks(case: BoardCase) -> None:
    measured, parser = read(case, AUTO)
    if case.auto:
        assert measured
        check_first_module(case, measured, parser.unit)
    else:
        assert measured == []
        assert re.search(case.message, explain(case.data[-6000:], parser, None, BAUD))


@pytest.mark.parametrize("case", [case for case in CASES if not case.readable], ids=lambda case: case.name)
def test_a_board_that_cannot_be_read_is_refused_with_the_reason(case: BoardCase) -> None:
    measured, parser = read(case, case.named)
    assert len(measured) <= 12  # until two sensors in turns are detected
    assert re.search(case.message, parser.problem or explain(case.data[-6000:], parser, None, BAUD))


@pytest.mark.parametrize(
    ("sent", "asked", "said"),
    [
        (b"", AUTO, "nothing arrives"),
        (np.random.default_rng(1).bytes(500), AUTO, "115200 baud"),
        (np.random.default_rng(1).bytes(500), "millimetres", "baud rate"),
        (b"92\r\n" * 20, "binary", "mm, cm or m"),
        (b"hello\r\nworld\r\n", AUTO, "'world'"),
        (
            b"\n" + b"range: 92\tstatus: range valid\tpeak signal: 7.31\tambient: 0.42\r\n" * 4,
            "metres",
            "pololu-vl53l1x-d",
        ),
        (b"\n" + b"12:34:56\r\n" * 20, AUTO, "12:34:56"),
    ],
)
def test_what_comes_and_is_not_read_is_quoted_with_a_cause(sent: bytes, asked: str, said: str) -> None:
    assert said in explain(sent, create_parser(asked), None, BAUD)


def opened(asked: str) -> tuple[SerialSource, list[RangeBatch]]:
    """A source whose port has been open for a while."""
    batches: list[RangeBatch] = []
    source = SerialSource(
        "/dev/none", create_parser(asked), BAUD, None, None, batches.append, lambda _: None, structlog.get_logger()
    )
    source._link.state = LinkState.OPEN
    source.on_opened(time.monotonic() - 60)
    return source, batches


def told(asked: str, lines: list[str]) -> SourceStatus:
    source, _ = opened(asked)
    source.on_received(b"\n", time.monotonic())
    for line in lines:
        source.on_received(f"{line}\r\n".encode(), time.monotonic())
    return source.status()


def test_the_status_tells_unit_and_the_last_lines() -> None:
    status = told("centimetres", ["9.2", "\x07oops", "9.3"])
    assert (status.state, status.problem, status.unit) == (DeviceState.STREAMING, "", "cm")
    assert status.recent_lines == ("'9.2'", "07 6f 6f 70 73", "'9.3'")


def test_whole_lines_that_are_not_read_are_never_said_not_to_come() -> None:
    status = told(AUTO, ["92"] * 40)
    assert status.state is DeviceState.SILENT
    assert "'92'" in status.problem
    assert "millimetres" in status.problem


def test_an_occasional_debug_line_raises_no_problem() -> None:
    lines = [f"{90 + k % 7}" if k % 10 else "loop 33 ms" for k in range(100)]
    assert told("pololu-vl53l0x", lines).problem == ""


@pytest.mark.parametrize("steps", [299, 301])
def test_a_range_that_never_changes_is_said_and_passed_on(steps: int) -> None:
    status = told("millimetres", ["92"] * steps)
    assert status.measurements == steps
    assert ("92 mm" in status.problem) == (steps > 300)
    assert told("millimetres", [*["92"] * 400, "93"]).problem == ""


def test_a_device_that_stops_is_silent_and_says_for_how_long(monkeypatch: pytest.MonkeyPatch) -> None:
    source, _ = opened("millimetres")
    at = time.monotonic()
    source.on_received(b"\n92\n93\n", at)
    monkeypatch.setattr(time, "monotonic", lambda: at + 7.2)
    assert source.status().problem == "The port is open, but nothing has arrived for 7 s."
    source.on_received(b"Traceback (most recent call last):\r\nOSError: [Errno 19] ENODEV\r\n>>> ", at + 8)
    monkeypatch.setattr(time, "monotonic", lambda: at + 20.0)
    assert re.search(r"for 12 s\. Before: .*ENODEV.*>>>", source.status().problem)
