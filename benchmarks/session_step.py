"""From "scan posted" to "next plan in hand": through the services over REST, beside the same loop in this process.

The peer does the same work without network, serialisation, store and processes: the ratio is what the services cost.
Each service's resident memory is read at the end of the run.
"""

from __future__ import annotations

import asyncio
import time

import numpy as np
import psutil
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar
from pretouch_registrar.warm_up import warm_up
from pretouch_simulation.demo import request_for
from pretouch_simulation.fingers.ideal import ThinBeam
from pretouch_simulation.in_process import InProcessDetector, InProcessRegistrar
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import Case, generator, make_case
from pretouch_simulation.scanning import scan_along
from pretouch_simulation.services import Services

from pretouch.client import RestClient

SEEDS = range(3)
_FINGER = ThinBeam()


def measure() -> dict[str, float]:
    """Milliseconds over all scans of all objects made in code, and MB of each service."""
    cases = [make_case(name, maker(), 0, seed) for seed in SEEDS for name, maker in MAKERS.items()]
    with Services() as services:
        served = np.concatenate([_time_served(services.rest, case) for case in cases])
        memory = _memory()
    registrar = Registrar()
    warm_up(registrar)
    local = np.concatenate([asyncio.run(_time_in_process(case, registrar)) for case in cases])
    figures = {"steps": float(len(served))}
    for name, seconds in (("services", served), ("in process", local)):
        for quantile in (50, 95):
            figures[f"{name} p{quantile} ms"] = 1000 * float(np.percentile(seconds, quantile))
    figures["ratio of medians"] = figures["services p50 ms"] / figures["in process p50 ms"]
    return figures | memory


def _time_served(url: str, case: Case) -> list[float]:
    """Seconds of each submitted scan of one session."""
    rng, steps = generator("finger", case.name), []
    with RestClient(url, timeout=60.0) as client:
        session = client.create_session(request_for(case, _FINGER.sensor), case.depth.metres, case.mask)
        while session.next_scan is not None:
            samples = scan_along(case.world, session.next_scan.path, _FINGER.sensor, _FINGER, rng)
            start = time.perf_counter()
            session = client.submit(session.id, session.next_scan.scan_id, samples)
            steps.append(time.perf_counter() - start)
    return steps


async def _time_in_process(case: Case, registrar: Registrar) -> list[float]:
    rng, steps = generator("finger", case.name), []
    loop = Loop(InProcessDetector(), InProcessRegistrar(Engine.POSTERIOR, registrar))
    record = await loop.open("benchmark", 0.0, request_for(case, _FINGER.sensor), case.depth, case.mask)
    while record.next_scan is not None:
        samples = scan_along(case.world, record.next_scan.path, _FINGER.sensor, _FINGER, rng)
        start = time.perf_counter()
        record = await loop.advance(record, record.next_scan.scan_id, samples)
        steps.append(time.perf_counter() - start)
    return steps


def _memory() -> dict[str, float]:
    """Resident MB of each service that this process started."""
    names = ("detector", "registrar", "gateway", "orchestrator")
    memory = {}
    for child in psutil.Process().children(recursive=True):
        words = child.cmdline()
        for name in names:
            if name in words:
                memory[f"{name} MB"] = child.memory_info().rss / 1e6
    return memory
