"""How long after its last byte a frame is in a subscriber's hand, beside a bare reader and a bare stream.

Gateway, bare pyserial reader and bare gRPC stream take turns, a third of a period apart, so that each meets the same
machine and none meets another. The bare stream is given no more to do than to yield a message of the gateway's size.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import gateway_fingers, gateway_peers, gateway_subscriber
from benchmarks.gateway_fingers import Job, Sent
from benchmarks.gateway_inbox import Received
from benchmarks.gateway_peers import Reading, Yielding
from benchmarks.gateway_process import GatewayProcess
from benchmarks.gateway_worker import Worker

WARM_UP = 60
"""Frames before the first that counts: the device is recognised and its clock found meanwhile."""
_PATIENCE = 10.0
_PARTS = ("gateway", "pyserial", "gRPC stream")


def measure(rates: dict[float, int], rounds: int, seed: int, advance: Callable[[str], None]) -> list[dict[str, Any]]:
    """A row for each rate: microseconds, medians over the rounds.

    Args:
        rates: Hz, and how many frames count at each.
    """
    rows = []
    with (
        Worker(gateway_fingers.run, 2, seed) as fingers,
        GatewayProcess(fingers.ready[:1]) as gateway,
        Worker(gateway_subscriber.run, gateway.address, gateway.devices) as subscriber,
        Worker(gateway_peers.read_ports, fingers.ready[1:]) as reader,
        Worker(gateway_peers.serve_streams) as server,
        Worker(gateway_peers.take_streams, server.ready, 1) as client,
    ):
        _round(100.0, WARM_UP, fingers, subscriber, reader, server, client)
        for rate, frames in rates.items():
            taken = []
            for number in range(rounds):
                advance(f"latency at {rate:g} Hz, round {number + 1} of {rounds}")
                taken.append(_round(rate, frames // rounds, fingers, subscriber, reader, server, client))
            rows.append({"rate_hz": rate, **_row(taken)})
        (status,) = gateway.statuses()
        lost = status.device.lost_frames + status.device.bad_frames + status.untimed + status.overrun
    return [row | {"lost": lost} for row in rows]


def _round(rate: float, frames: int, *workers: Worker) -> dict[str, NDArray[np.float64]]:
    """Seconds that each frame took, by part."""
    fingers, subscriber, reader, server, client = workers
    start = gateway_fingers.start_of_job(2 * frames)
    third = 1 / rate / 3
    reader.tell(Reading(frames, start))
    server.tell(Yielding(frames, rate, start, 2 * third))
    patience = _PATIENCE + frames / rate
    device, bare = fingers.ask(Job((0, 1), (0.0, third), frames, rate, start), patience)
    (received,) = subscriber.ask((frames, _PATIENCE), 2 * _PATIENCE)
    (streamed,) = client.ask((frames, _PATIENCE), 2 * _PATIENCE)
    read = reader.answer(_PATIENCE)
    if len(read) < frames or len(streamed.keys) < frames:
        raise RuntimeError(f"the peers got {len(read)} and {len(streamed.keys)} of {frames} frames")
    return {
        "gateway": _through_gateway(device, received),
        "pyserial": (read - bare.stamps) * 1e-9,
        "gRPC stream": (streamed.stamps - streamed.keys) * 1e-9,
    }


def _through_gateway(sent: Sent, received: Received) -> NDArray[np.float64]:
    order = received.keys - sent.first
    known = (order >= 0) & (order < len(sent.stamps))  # else a rest of what came before
    return np.asarray((received.stamps[known] - sent.stamps[order[known]]) * 1e-9)


def _row(rounds: list[dict[str, NDArray[np.float64]]]) -> dict[str, Any]:
    row: dict[str, Any] = {"n": sum(len(taken["gateway"]) for taken in rounds), "rounds": len(rounds)}
    for name, percent in (("p50", 50), ("p99", 99)):
        each = {part: 1e6 * np.array([np.percentile(taken[part], percent) for taken in rounds]) for part in _PARTS}
        row[name] = {part: float(np.median(values)) for part, values in each.items()}
        ratios = each["gateway"] / (each["pyserial"] + each["gRPC stream"])
        row[name] |= {"ratio": float(np.median(ratios)), "ratio_rounds": ratios.tolist()}
    row["max"] = {part: 1e6 * float(max(taken[part].max() for taken in rounds)) for part in _PARTS}
    return row
