"""How long `tell` takes while the robot moves, beside the `submit` of the same scans: services as they are, over REST.

The robot moves in real time: it tells a quarter of a second of samples every quarter of a second, as they are measured,
with a thin and with a wide beam, until its session ends. The peer is what a robot without `tell` would wait for.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from itertools import product

import numpy as np
from pretouch_simulation.demo import request_for
from pretouch_simulation.finger import FingerModel, realise
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import Case, generator, make_case
from pretouch_simulation.robot_motion import PIECE
from pretouch_simulation.scanning import cut_pieces, scan_along
from pretouch_simulation.services import Services

from pretouch.client import RestClient
from pretouch.session import SampleChunk
from pretouch.tof import RangeSamples

_FINGERS = {"thin": FingerModel.IDEAL, "wide": FingerModel.VL6180X}
_LEAST = 100
"""Tellings of each finger."""
_NOTHING = RangeSamples.concatenate([])


def measure() -> dict[str, float]:
    """Milliseconds of tellings, and of submissions of whole scans, for each finger."""
    figures: dict[str, float] = {}
    with Services() as services, RestClient(services.rest, timeout=60.0) as client:
        for name, model in _FINGERS.items():
            told, submitted = _measure_finger(client, model)
            for step, seconds in ((f"tell, {name}", told), (f"submit, {name}", submitted)):
                figures[f"{step}: n"] = float(len(seconds))
                for quantile in (50, 95):
                    figures[f"{step}: p{quantile} ms"] = 1000 * float(np.percentile(seconds, quantile))
            figures[f"tell / submit, {name}: medians"] = float(np.median(told) / np.median(submitted))
    return figures


def _measure_finger(client: RestClient, model: FingerModel) -> tuple[list[float], list[float]]:
    """Seconds of each telling, and of each submission of a scan of which nothing was told, in other sessions."""
    told: list[float] = []
    submitted: list[float] = []
    for case in _cases():
        if len(told) >= _LEAST:
            break
        told += _run_session(client, case, model, tell=True)
        submitted += _run_session(client, case, model, tell=False)
    return told, submitted


def _cases() -> Iterator[Case]:
    for seed, (name, maker) in product(range(3), MAKERS.items()):
        yield make_case(name, maker(), 0, seed)


def _run_session(client: RestClient, case: Case, model: FingerModel, *, tell: bool) -> list[float]:
    """Seconds of each call of one session's scans."""
    finger, rng = realise(model, generator("finger-model", case.name)), generator("finger", case.name)
    session = client.create_session(request_for(case, finger.sensor), case.depth.metres, case.mask)
    calls: list[float] = []
    while session.next_scan is not None:
        plan = session.next_scan
        samples = scan_along(case.world, plan.path, finger.sensor, finger, rng)
        if tell:
            calls += _tell_in_real_time(client, session.id, plan.scan_id, samples)
            session = client.submit(session.id, plan.scan_id, _NOTHING)
        else:
            started = time.perf_counter()
            session = client.submit(session.id, plan.scan_id, samples)
            calls.append(time.perf_counter() - started)
    return calls


def _tell_in_real_time(client: RestClient, session_id: str, scan_id: str, samples: RangeSamples) -> list[float]:
    calls: list[float] = []
    started, told = time.perf_counter(), 0
    for number, piece in enumerate(cut_pieces(samples), start=1):
        time.sleep(max(0.0, started + number * PIECE - time.perf_counter()))
        begun = time.perf_counter()
        progress = client.tell(session_id, scan_id, SampleChunk(told, piece))
        calls.append(time.perf_counter() - begun)
        told = progress.told
        if progress.enough:
            break
    return calls
