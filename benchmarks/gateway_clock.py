"""Prints how good the gateway's clocks are on simulated devices, as tables: `python -m benchmarks.gateway_clock`."""

from __future__ import annotations

import time

import numpy as np
from pretouch_sensor_gateway.clock.ping_clock import PingClock

from benchmarks.clock_devices import CASES, START, Case, FormerClock, ping_device
from benchmarks.text_devices import TEXT_CASES, TextCase, print_lines

SECONDS = 3600.0
SILENCE = (1500.0, 2100.0)
SEEDS = range(3)
TEXT_SECONDS, WARM, TEXT_SEEDS = 60.0, 10.0, range(40)
"""Of each board that prints: a run, of which the first seconds do not count, and seeds, each with its own phase."""


def figures(case: Case) -> list[float]:
    """The row of a case: in ms, %, ppm, as the table's head says."""
    rows = []
    for seed in SEEDS:
        run = ping_device(PingClock(), case, SECONDS, seed, silence=SILENCE)
        former = ping_device(FormerClock(), case, SECONDS, seed, silence=SILENCE)
        error, std = (
            np.concatenate(both) for both in zip(run.between(0, 1500), run.between(2110, SECONDS), strict=True)
        )
        before = np.concatenate([former.between(0, 1500)[0], former.between(2110, SECONDS)[0]])
        silent, silent_std = run.between(2090, 2100)
        age = np.array(run.ping_age)
        drift = np.abs(run.drift_error)[((age > 60) & (age < 1500)) | (age > 2160)]
        rows.append(
            [
                np.median(error) * 1e3,
                np.sqrt(np.mean(error**2)) * 1e3,
                np.median(std) * 1e3,
                np.mean(error <= 2 * std) * 100,
                np.mean(error <= 3 * std) * 100,
                np.sqrt(np.mean(before**2) / np.mean(error**2)),
                np.median(drift) * 1e6,
                np.median(silent) * 1e3,
                np.median(silent_std) * 1e3,
            ]
        )
    return [float(value) for value in np.mean(rows, axis=0)]


def text_figures(case: TextCase) -> list[float]:
    """The row of a case: in ms and %, as the table's head says."""
    errors, stds = [], []
    for seed in TEXT_SEEDS:
        error, std = print_lines(case, TEXT_SECONDS, seed)
        counted = round(WARM * case.rate)
        errors.append(error[counted:])
        stds.append(std[counted:])
    error, std = np.concatenate(errors), np.concatenate(stds)
    size = np.abs(error)
    return [
        float(np.mean(error)) * 1e3,
        float(np.sqrt(np.mean(error**2))) * 1e3,
        float(np.sqrt(np.mean(std**2))) * 1e3,
        float(np.mean(size <= 2 * std)) * 100,
        float(np.mean(size <= 3 * std)) * 100,
    ]


def costs() -> tuple[float, float]:
    """Processor microseconds of a ping, and of a frame's time."""
    clock, rng = PingClock(), np.random.default_rng(0)
    pings = [(START + k, START + k + 1e-3 + rng.exponential(1e-3), k + 5e-4) for k in range(1100)]
    for ping in pings[:100]:
        clock.add_ping(*ping)
    began = time.process_time()
    for ping in pings[100:]:
        clock.add_ping(*ping)
    learned = time.process_time()
    for k in range(100_000):
        clock.host_time(1100 + k * 1e-5)
    return (learned - began) / 1000 * 1e6, (time.process_time() - learned) / 100_000 * 1e6


def main() -> None:
    print(f"An hour each, {len(SEEDS)} seeds; a ping a second, none for ten minutes. Errors in ms, drift in ppm.")
    print(
        "| device | median error | rms | median std | within 2 std, % | 3 std, % | former rms / rms | drift error |",
        end="",
    )
    print(" error after 600 s of silence | std then |")
    print("|---|" + "---|" * 9)
    for name, case in CASES.items():
        values = figures(case)
        print(f"| {name} | " + " | ".join(f"{value:.4g}" for value in values) + " |", flush=True)
    runs = f"{TEXT_SECONDS:g} s each, {len(TEXT_SEEDS)} seeds, the first {WARM:g} s not counted"
    print(f"\nBoards that print lines: {runs}. Errors in ms.")
    print("| board | mean error | rms | rms std | within 2 std, % | 3 std, % |")
    print("|---|" + "---|" * 5)
    for name, text_case in TEXT_CASES.items():
        print(f"| {name} | " + " | ".join(f"{value:.4g}" for value in text_figures(text_case)) + " |", flush=True)
    print("A ping costs {:.0f} us, a frame's time {:.1f} us of a processor.".format(*costs()))


if __name__ == "__main__":
    main()
