"""A session's replay beside the live session: registrations alone, in this process, against steps through the services.

A step plans the next scan, too; a live session waits for the robot besides, whose seconds are told, not waited for.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from pretouch_registrar.registration import Registrar
from pretouch_registrar.replay import read_recorded, replay
from pretouch_registrar.warm_up import warm_up
from pretouch_simulation.demo import request_for
from pretouch_simulation.fingers.ideal import ThinBeam
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import Case, generator, make_case
from pretouch_simulation.scanning import scan_along
from pretouch_simulation.services import Services

from pretouch.client import RestClient
from pretouch.recording.session_file import read_session_recording
from pretouch.session import Session

SEEDS = range(3)
_FINGER = ThinBeam()
_FIGURES = ("scans", "identical", "robot s", "steps s", "recording s", "replay s", "replay total s")


def measure() -> dict[str, float]:
    """Seconds of all sessions together, of all objects made in code."""
    registrar = Registrar()
    warm_up(registrar)
    totals = dict.fromkeys(
        ("scans", "identical", "robot s", "steps s", "recording s", "replay s", "replay total s"), 0.0
    )
    with (
        Services() as services,
        RestClient(services.rest, timeout=60.0) as client,
        tempfile.TemporaryDirectory() as folder,
    ):
        for seed in SEEDS:
            for name, maker in MAKERS.items():
                session, steps = _run_live(client, make_case(name, maker(), 0, seed))
                path, start = Path(folder) / f"{session.id}.mcap", time.perf_counter()
                path.write_bytes(client.recording(session.id))
                written = time.perf_counter()
                recorded = read_recorded(read_session_recording(path))
                replayed = list(replay(recorded, recorded.settings, registrar))
                ended = time.perf_counter()
                totals["scans"] += len(replayed)
                totals["identical"] += sum(each.identical for each in replayed)
                totals["robot s"] += session.budget_used.seconds
                totals["steps s"] += steps
                totals["recording s"] += written - start
                totals["replay s"] += sum(each.seconds for each in replayed)
                totals["replay total s"] += ended - written
    return totals | {"replay total by steps": totals["replay total s"] / totals["steps s"]}


def _run_live(client: RestClient, case: Case) -> tuple[Session, float]:
    """A session at its end, and the seconds that its steps took."""
    rng, seconds = generator("finger", case.name), 0.0
    session = client.create_session(request_for(case, _FINGER.sensor), case.depth.metres, case.mask)
    while session.next_scan is not None:
        samples = scan_along(case.world, session.next_scan.path, _FINGER.sensor, _FINGER, rng)
        start = time.perf_counter()
        session = client.submit(session.id, session.next_scan.scan_id, samples)
        seconds += time.perf_counter() - start
    return session, seconds
