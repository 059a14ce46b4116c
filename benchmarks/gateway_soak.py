"""Whether the gateway's memory stays where it is: devices, listeners and recordings for a while.

The history of the last ten minutes lies in a ring for each device, which doubles until it holds them: at 30 Hz for the
last time after nine minutes. What it takes is known to the byte and told apart, so that the rest should be flat.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pretouch_sensor_gateway.history import MAX_MEASUREMENTS, SPAN

from benchmarks import gateway_fingers, gateway_subscriber
from benchmarks.gateway_fingers import MODULES, Job
from benchmarks.gateway_process import GatewayProcess
from benchmarks.gateway_worker import Worker

RATE = 30.0
DEVICES = 8
_HISTORY_ROW = 8 + 8 + MODULES * (8 + 1 + 1 + 4)
"""Bytes of a frame in the history: time, its sigma, and the range, status, flags and std of each module."""
_FIRST_ROOM = 1024
_PATIENCE = 30.0


def measure(seconds: float, interval: float, seed: int, advance: Callable[[str], None]) -> dict[str, Any]:
    """Resident memory every `interval` s, its slope, and whether all frames arrived and were recorded."""
    with tempfile.TemporaryDirectory() as folder, Worker(gateway_fingers.run, DEVICES, seed) as fingers:
        with (
            GatewayProcess(fingers.ready, Path(folder)) as gateway,
            Worker(gateway_subscriber.run, gateway.address, gateway.devices) as subscriber,
        ):
            count = round(RATE * seconds)
            start = gateway_fingers.start_of_job(count * DEVICES)
            phases = [k / DEVICES / RATE for k in range(DEVICES)]
            fingers.tell(Job(range(DEVICES), phases, count, RATE, start))
            samples = []
            for k in range(int(seconds / interval) + 1):
                time.sleep(max(0.0, start * 1e-9 + k * interval - time.monotonic()))
                samples.append((time.monotonic() - start * 1e-9, gateway.usage()))
                advance(f"soak, {samples[-1][0]:.0f} of {seconds:.0f} s: {samples[-1][1].rss / 1e6:.1f} MB")
            sent = sum(len(each.stamps) for each in fingers.answer(_PATIENCE))
            received = subscriber.ask((count, _PATIENCE), 2 * _PATIENCE)
            statuses = gateway.statuses()
        recorded = sum(path.stat().st_size for path in Path(folder).rglob("*.mcap"))
    t = np.array([at for at, _ in samples])
    rss = np.array([usage.rss for _, usage in samples]) / 1e3
    history = DEVICES * _HISTORY_ROW / 1e3 * np.array([_ring(RATE * at) for at in t])
    minute = min(60.0, seconds / 3)
    later = t >= minute
    return {
        "seconds": seconds,
        "devices": DEVICES,
        "rate_hz": RATE,
        "sent": sent,
        "delivered": sum(len(each.keys) for each in received),
        "lost": sum(status.device.lost_frames + status.device.bad_frames + status.overrun for status in statuses),
        "unrecorded": sum(status.recording.unrecorded for status in statuses),
        "recorded_mb": recorded / 1e6,
        "core_share": float((samples[-1][1].cpu - samples[0][1].cpu) / (t[-1] - t[0])),
        "first_minute_mb": float(np.median(rss[t <= minute])) / 1e3,
        "last_minute_mb": float(np.median(rss[t >= t[-1] - minute])) / 1e3,
        "warm_up_s": minute,
        "slope_kb_per_minute": _slope(t[later], rss[later]),
        "history_kb_per_minute": _slope(t[later], history[later]),
        "slope_without_history_kb_per_minute": _slope(t[later], (rss - history)[later]),
        "t_s": t.round(2).tolist(),
        "rss_kb": rss.tolist(),
    }


def _ring(frames: float) -> int:
    """Measurements for which a device's history has room after so many."""
    room = _FIRST_ROOM
    while room < frames and room <= RATE * SPAN and room < MAX_MEASUREMENTS:
        room *= 2
    return room


def _slope(t: np.ndarray, kilobytes: np.ndarray) -> float:
    """kB a minute, by least squares."""
    return 60 * float(np.polyfit(t, kilobytes, 1)[0])
