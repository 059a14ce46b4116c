"""Simulated devices with clocks that drift, on lines that delay: test cases for the gateway's clocks."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pretouch_sensor_gateway.clock.ping_clock import HostTime, PingClock
from pretouch_sensor_gateway.clock.tick_unwrapper import TickUnwrapper

START = 1000.0
WRAP = 2**32
_BYTE_9600 = 10 / 9600
Delay = Callable[[np.random.Generator], float]


def log_normal(median: float, sigma: float) -> Delay:
    return lambda rng: median * math.exp(sigma * rng.standard_normal())


def usb(least: float) -> Delay:
    """A USB frame of 1 ms to wait for, and a scheduler."""
    return lambda rng: least + rng.uniform(0, 1e-3) + rng.exponential(2e-4)


def latency_timer(least: float) -> Delay:
    """A serial converter that holds back what it has for up to 16 ms."""
    return lambda rng: least + rng.uniform(0, 16e-3)


def behind_ranges(usual: Delay, busy: float, longest: float) -> Delay:
    """A board that answers when its line is free: the line is busy for a share of the time, for `longest` s at most."""
    return lambda rng: usual(rng) + (rng.uniform(0, longest) if rng.random() < busy else 0.0)


def hiccups(usual: Delay, share: float = 0.02) -> Delay:
    """Now and then a host is busy for 20 to 50 ms more."""
    return lambda rng: usual(rng) + (rng.uniform(0.02, 0.05) if rng.random() < share else 0.0)


@dataclass(frozen=True)
class Oscillator:
    """A device's clock: fast by `drift` s/s, and by `swing` more and less as it warms and cools once an hour."""

    drift: float = 0.0
    swing: float = 0.0
    resolution: float = 1e-6
    first: int = WRAP - 3_000_000

    def rate(self, host: float) -> float:
        return self.drift + self.swing * math.sin(2 * math.pi * (host - START) / 3600)

    def micros(self, host: float) -> int:
        pace = 2 * math.pi / 3600
        elapsed = host - START
        reading = elapsed * (1 + self.drift) + self.swing * (1 - math.cos(pace * elapsed)) / pace
        ticks = math.floor(reading / self.resolution) * self.resolution
        return (self.first + round(ticks * 1e6)) % WRAP


@dataclass(frozen=True)
class Case:
    there: Delay
    back: Delay
    oscillator: Oscillator


CASES = {
    "crystal, 1 ms each way, log-normal": Case(log_normal(1e-3, 0.5), log_normal(1e-3, 0.5), Oscillator(50e-6)),
    "crystal, uneven ways, hiccups": Case(
        hiccups(log_normal(4e-4, 0.4)), hiccups(log_normal(2e-3, 0.6)), Oscillator(-50e-6)
    ),
    "crystal, USB frames": Case(usb(2e-4), usb(4e-4), Oscillator(30e-6)),
    "crystal, 16 ms latency timer": Case(log_normal(5e-4, 0.3), latency_timer(1e-3), Oscillator(20e-6)),
    "crystal, 10 ppm with temperature, hiccups": Case(
        hiccups(usb(2e-4)), hiccups(usb(4e-4)), Oscillator(20e-6, swing=10e-6)
    ),
    "resonator, 5000 ppm, hiccups": Case(
        hiccups(log_normal(1e-3, 0.5)), hiccups(log_normal(1e-3, 0.5)), Oscillator(5e-3, resolution=4e-6)
    ),
    "RC, 5 %, 500 ppm with temperature": Case(usb(2e-4), usb(4e-4), Oscillator(0.05, swing=5e-4)),
    "crystal, UART at 9600 baud": Case(  # a ping of 17 bytes, a reply of 15, ranges of 23 bytes at 30 Hz
        behind_ranges(usb(17 * _BYTE_9600), 30 * 23 * _BYTE_9600, 23 * _BYTE_9600),
        usb(15 * _BYTE_9600),
        Oscillator(50e-6),
    ),
    "crystal counting milliseconds, USB frames": Case(usb(2e-4), usb(4e-4), Oscillator(30e-6, resolution=1e-3)),
}
"""Delays and oscillators as they are met. Temperature goes up and down once an hour."""


@dataclass
class Run:
    """The result, s: errors and stated deviations of frames' times, errors of the drift after each ping, ages.

    A step is by how much a ping changed the time of its own moment, in deviations stated before.
    """

    age: list[float] = field(default_factory=list)
    error: list[float] = field(default_factory=list)
    std: list[float] = field(default_factory=list)
    ping_age: list[float] = field(default_factory=list)
    drift_error: list[float] = field(default_factory=list)
    step: list[float] = field(default_factory=list)
    round_trip: list[float] = field(default_factory=list)

    def between(self, first: float, last: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """|error| and std, s, of the frames of these ages."""
        age = np.array(self.age)
        chosen = (age >= first) & (age < last)
        return np.abs(np.array(self.error))[chosen], np.array(self.std)[chosen]


class FormerClock:
    """The gateway's former clock: the one recent ping with the least bound on its error, and no drift."""

    drift = 0.0

    def __init__(self) -> None:
        self._pings: list[tuple[float, float, float]] = []

    @property
    def round_trip(self) -> float:
        return self._best[2]

    def add_ping(self, sent: float, received: float, device: float) -> None:
        self._pings = [*self._pings[-31:], (device, (sent + received) / 2, received - sent)]
        self._best = min(self._pings, key=lambda ping: ping[2] / 2 + 1e-4 * (received - ping[1]))

    def host_time(self, device: float) -> HostTime:
        at, host, round_trip = self._best
        return HostTime(host + device - at, round_trip / math.sqrt(12))


def ping_device(
    clock: PingClock | FormerClock,
    case: Case,
    seconds: float,
    seed: int,
    interval: float = 1.0,
    silence: tuple[float, float] = (math.inf, math.inf),
) -> Run:
    """Pings a device, eight times quickly and then each `interval` s, and times three frames between two pings.

    Args:
        silence: ages between which no ping is answered, though frames come.
    """
    rng = np.random.default_rng(seed)
    counter = TickUnwrapper(WRAP)
    run = Run()
    host, pings = START, 0
    while host < START + seconds:
        if not silence[0] <= host - START < silence[1]:
            answered_at = host + case.there(rng)
            received = answered_at + case.back(rng)
            micros = case.oscillator.micros(answered_at)
            assert counter.follows(micros, received)
            device = counter.unwrap(micros, received)
            before = clock.host_time(device) if pings else None
            clock.add_ping(host, received, device)
            after = clock.host_time(device)
            assert after is not None
            if before is not None:
                run.step.append(abs(after.at - before.at) / before.std)
            run.ping_age.append(host - START)
            run.drift_error.append(clock.drift - case.oscillator.rate(answered_at))
            run.round_trip.append(clock.round_trip)
        gap = 0.05 if pings < 8 else interval
        pings += 1
        for moment in np.sort(host + 0.1 * gap + rng.uniform(0, 0.9 * gap, 3)).tolist():
            found = clock.host_time(counter.unwrap(case.oscillator.micros(moment), moment + 0.005))
            assert found is not None
            run.age.append(moment - START)
            run.error.append(found.at - moment)
            run.std.append(found.std)
        host += gap + rng.uniform(0, 2e-4)
    return run
