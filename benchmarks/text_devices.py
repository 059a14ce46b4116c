"""Simulated boards that print lines over a UART, read byte by byte as a driver does: test cases for their times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pretouch_sensor_gateway.measurement_pipeline import MeasurementPipeline
from pretouch_sensor_gateway.wire_formats.registry import create_parser

from benchmarks.clock_devices import Oscillator

UNIX = 1.7e9
"""Unix time at host time 0."""
_RATE = 30.0


@dataclass(frozen=True)
class TextCase:
    """A sketch, its line and the driver that reads it.

    Attributes:
        baud: bits a second.
        timed: whether each line begins with the board's `millis()`.
        rate: lines a second.
        single_shot: s from the measurement to the begin of the line, of a sketch that measures, prints and waits; None:
            the sensor runs freely, and the line holds what it measured at some moment of the period before.
        stated: the `latency` in the configuration.
        poll: s between two times that the driver looks: a USB frame, or a latency timer.
        busy: share of looks for which the host is busy for 20 to 50 ms more.
    """

    baud: int
    timed: bool = False
    rate: float = _RATE
    single_shot: float | None = None
    stated: float | None = None
    poll: float = 1e-3
    busy: float = 0.0


TEXT_CASES = {
    "115200 baud": TextCase(115_200),
    "115200 baud, latency timer": TextCase(115_200, poll=16e-3),
    "9600 baud": TextCase(9600),
    "9600 baud, millis()": TextCase(9600, timed=True),
    "9600 baud, latency timer, hiccups": TextCase(9600, poll=16e-3, busy=0.01),
    "9600 baud, millis(), latency timer, hiccups": TextCase(9600, timed=True, poll=16e-3, busy=0.01),
    "single shot at 7 Hz, latency not stated": TextCase(115_200, rate=7.0, single_shot=0.022),
    "single shot at 7 Hz, latency stated": TextCase(115_200, rate=7.0, single_shot=0.022, stated=0.022),
    "9600 baud, single shot, millis(), latency stated": TextCase(9600, True, single_shot=0.022, stated=0.022),
}


def print_lines(case: TextCase, seconds: float, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Runs a board for that time; the errors of its lines' times, and their stated deviations, s."""
    rng = np.random.default_rng(seed)
    oscillator = Oscillator(50e-6, resolution=1e-3)
    period = 1 / case.rate
    count = round(seconds / period)
    begins = 1000.0 + np.arange(count) * period + 1e-4 * rng.standard_normal(count)
    measured = begins - (rng.uniform(0, period) if case.single_shot is None else case.single_shot)
    lines, sent = [], []
    for begin in begins.tolist():
        time = f"{oscillator.micros(begin) // 1000} " if case.timed else ""
        line = f"{time}{' '.join(map(str, rng.integers(30, 90, 7 - 3 * case.timed)))}\r\n".encode()
        lines.append(line)
        sent.append(begin + (np.arange(len(line)) + 1) * 10 / case.baud)
    pipeline = MeasurementPipeline(
        create_parser("time-millimetres" if case.timed else "millimetres"), 10 / case.baud, None, case.stated
    )
    pipeline.on_port_opened(1000.0)
    found: list[tuple[float, float]] = []
    first = rng.uniform(0, case.poll)
    looks = np.ceil((np.concatenate(sent) - first) / case.poll) * case.poll + first
    data, ends = b"".join(lines), np.flatnonzero(np.diff(looks, append=np.inf)) + 1
    start, last = 0, 0.0
    for end in ends.tolist():
        last = max(last, looks[end - 1] + rng.exponential(2e-4))
        if rng.random() < case.busy:
            last += rng.uniform(0.02, 0.05)
        for batch in pipeline.feed(data[start:end], last, UNIX + last):
            found += [(float(t), batch.time_std) for t in batch.t]
        start = end
    t, std = np.array(found).T
    return t - UNIX - measured[len(measured) - len(t) :], std
