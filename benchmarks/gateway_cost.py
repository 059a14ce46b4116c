"""What the gateway costs for some devices: share of a core, and memory; beside a bare reader and bare streams."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from benchmarks import gateway_fingers, gateway_peers, gateway_subscriber
from benchmarks.gateway_fingers import Job
from benchmarks.gateway_peers import Reading, Yielding
from benchmarks.gateway_process import GatewayProcess
from benchmarks.gateway_usage import Usage
from benchmarks.gateway_worker import Worker

RATE = 30.0
_EDGE = 0.3
"""Seconds of running before and after those that count."""
_WARM_UP = 0.5
_PATIENCE = 20.0


def measure(devices: Sequence[int], seconds: float, seed: int, advance: Callable[[str], None]) -> list[dict[str, Any]]:
    """Rows for each number of devices: without a listener, with one each, and of the peers; CPU over `seconds`."""
    rows = []
    with Worker(gateway_fingers.run, max(devices), seed) as fingers:
        for count in devices:
            rows += _gateway(fingers, count, seconds, advance)
            advance(f"cost of the peers at {count} devices")
            rows.append(_peers(fingers, count, seconds))
    return rows


def _gateway(fingers: Worker, count: int, seconds: float, advance: Callable[[str], None]) -> list[dict[str, Any]]:
    with GatewayProcess(fingers.ready[:count]) as gateway:
        fingers.ask(_job(count, _WARM_UP), _PATIENCE)
        advance(f"cost at {count} devices without listeners")
        rows = [_row(count, "gateway, no listener", fingers, _job(count, seconds), (gateway.usage,))]
        with Worker(gateway_subscriber.run, gateway.address, gateway.devices) as subscriber:
            advance(f"cost at {count} devices with a listener each")
            job = _job(count, seconds)
            rows.append(_row(count, "gateway, a listener each", fingers, job, (gateway.usage,)))
            received = subscriber.ask((job.count, _PATIENCE), 2 * _PATIENCE)
        delivered = sum(len(each.keys) for each in received)
        lost = sum(status.device.lost_frames + status.overrun for status in gateway.statuses())
    return [rows[0], rows[1] | {"delivered": delivered, "lost": lost}]


def _peers(fingers: Worker, count: int, seconds: float) -> dict[str, Any]:
    """A bare reader of all ports, and a bare server of as many streams: two processes, added up.

    Of their memory nothing is said, for they are forked from a process that has loaded more than they need.
    """
    with (
        Worker(gateway_peers.read_ports, fingers.ready[:count]) as reader,
        Worker(gateway_peers.serve_streams) as server,
        Worker(gateway_peers.take_streams, server.ready, count) as client,
    ):
        job = _job(count, seconds)
        reader.tell(Reading(count * job.count, job.start))
        server.tell(Yielding(job.count, job.rate, job.start))
        row = _row(count, "pyserial + gRPC streams", fingers, job, (reader.usage, server.usage))
        row["rss_mb"] = row["uss_mb"] = None
        reader.answer(_PATIENCE)
        client.ask((job.count, _PATIENCE), 2 * _PATIENCE)
    return row


def _job(count: int, seconds: float) -> Job:
    """All of the first `count` fingers, one after the other."""
    frames = round(RATE * (seconds + 2 * _EDGE))
    phases = [k / count / RATE for k in range(count)]
    return Job(range(count), phases, frames, RATE, gateway_fingers.start_of_job(count * frames))


def _row(count: int, what: str, fingers: Worker, job: Job, used: Sequence[Callable[[], Usage]]) -> dict[str, Any]:
    """CPU between the edges of a job, and memory at its end."""
    fingers.tell(job)
    seconds = job.count / job.rate
    _wait_until(job.start * 1e-9 + _EDGE)
    began, before = time.monotonic(), [usage() for usage in used]
    _wait_until(job.start * 1e-9 + seconds - _EDGE)
    ended, after = time.monotonic(), [usage() for usage in used]
    fingers.answer(_PATIENCE)
    cpu = sum(usage.cpu for usage in after) - sum(usage.cpu for usage in before)
    return {
        "devices": count,
        "what": what,
        "seconds": ended - began,
        "core_share": cpu / (ended - began),
        "us_per_frame": 1e6 * cpu / (count * job.rate * (ended - began)),
        "rss_mb": sum(usage.rss for usage in after) / 1e6,
        "uss_mb": sum(usage.uss for usage in after) / 1e6,
    }


def _wait_until(moment: float) -> None:
    time.sleep(max(0.0, moment - time.monotonic()))
