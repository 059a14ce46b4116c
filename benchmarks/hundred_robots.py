"""Many robots at once on one `pretouch up`: `python -m benchmarks.hundred_robots [--robots 100] [--json OUT]`.

Each robot has a scene, a pose of its object and a session of its own, over REST or gRPC in turn, and starts at the same
moment as the others. It scans without delay, which is more than any real robot asks for, and obeys `Retry-After`
through the SDK. Every answer is checked to be about the robot's own session: its id, its object, its scans and their
samples. The simulated fingers run in this process, on the same cores as the services.
"""

from __future__ import annotations

import argparse
import json
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pretouch_simulation.demo import request_for
from pretouch_simulation.fingers.ideal import ThinBeam
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import Case, generator, make_case
from pretouch_simulation.scanning import scan_along
from pretouch_simulation.services import Services

from benchmarks.service_usage import read_usage
from pretouch.client import GrpcClient, RestClient, SyncClient
from pretouch.client.retries import Attempts
from pretouch.errors import PretouchError
from pretouch.geometry import Pose
from pretouch.session import Session
from pretouch.tof import RangeSamples

_FINGER = ThinBeam()
_PATIENCE = 1800.0
"""s that a robot waits for one answer."""
_CLOSE = 1e-6


@dataclass
class Robot:
    """One robot: what it asks for, and what it met.

    Attributes:
        base_T_object: like no other robot's.
        waits: s that each call took, with all of its repetitions.
        mixed: what in an answer was another robot's.
    """

    number: int
    case: Case
    base_T_object: Pose
    waits: list[float] = field(default_factory=list)
    mixed: list[str] = field(default_factory=list)
    state: str = "not ended"
    failure: str = ""
    session_id: str = ""
    error: float = float("nan")
    scans: int = 0

    def run(self, rest: str, grpc: str, start: threading.Barrier) -> None:
        client: SyncClient[Any, Any] = (
            GrpcClient(grpc, timeout=_PATIENCE) if self.number % 2 else RestClient(rest, timeout=_PATIENCE)
        )
        with client:
            start.wait()
            try:
                self._scan(client)
            except PretouchError as error:
                self.failure = f"{type(error).__name__}: {error}"

    def _scan(self, client: SyncClient[Any, Any]) -> None:
        rng = generator("finger", self.case.name, self.number)
        asked = replace(request_for(self.case, _FINGER.sensor), base_T_object=self.base_T_object)
        session = self._timed(partial(client.create_session, asked, self.case.depth.metres, self.case.mask))
        self.session_id = session.id
        centroid, done = session.estimate.centroid, list[RangeSamples]()
        while session.next_scan is not None:
            plan = session.next_scan
            done.append(scan_along(self.case.world, plan.path, _FINGER.sensor, _FINGER, rng))
            session = self._timed(partial(client.submit, session.id, plan.scan_id, done[-1]))
            self._check(session, centroid, done, plan.scan_id)
        self._check(self._timed(partial(client.session, session.id)), centroid, done, None)
        self.state, self.scans = session.state.value, len(done)
        self.error = self.case.error(session.estimate.base_T_correction)

    def _timed(self, call: Callable[[], Session]) -> Session:
        began = time.perf_counter()
        session = call()
        self.waits.append(time.perf_counter() - began)
        return session

    def _check(self, session: Session, centroid: Any, done: list[RangeSamples], scan_id: str | None) -> None:
        ours = session.estimate.base_T_correction @ self.base_T_object
        same = {
            "id": session.id == self.session_id,
            "object": session.base_T_object is not None and session.base_T_object.is_close(ours, _CLOSE),
            "centroid": bool(np.allclose(session.estimate.centroid, centroid, atol=_CLOSE)),
            "scans": len(session.scans) == len(done) == session.budget_used.scans,
            "samples": [scan.samples for scan in session.scans] == [len(samples) for samples in done],
            "last scan": scan_id is None or (bool(session.scans) and session.scans[-1].scan_id == scan_id),
        }
        self.mixed += [name for name, holds in same.items() if not holds]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=100)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    arguments = parser.parse_args()
    robots = [_make_robot(number) for number in range(arguments.robots)]
    figures = measure(robots)
    for name, value in figures.items():
        print(f"{name:34} {value:10.3f}")
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n")
    for robot in robots:
        if robot.failure or robot.mixed:
            print(f"robot {robot.number}: {robot.failure} {robot.mixed}")
    return 0 if figures["ended"] == len(robots) and not figures["mixed"] else 1


def _make_robot(number: int) -> Robot:
    name = sorted(MAKERS)[number % len(MAKERS)]
    pose = Pose.from_rotation_vector((0.0, 0.0, 0.01 * number), (0.5, 0.001 * number, 0.05))
    return Robot(number, make_case(name, MAKERS[name](), 0, seed=number), pose)


def measure(robots: list[Robot]) -> dict[str, float]:
    """Seconds, counts, MB and CPU-seconds of all robots at once."""
    obeyed, start = _count_repetitions(), threading.Barrier(len(robots) + 1)
    with Services() as services, ThreadPoolExecutor(len(robots)) as threads:
        before = read_usage(services.pid)
        running = [threads.submit(robot.run, services.rest, services.grpc, start) for robot in robots]
        start.wait()
        began = time.perf_counter()
        for robot in running:
            robot.result()
        wall = time.perf_counter() - began
        after = read_usage(services.pid)
    waits = np.array([wait for robot in robots for wait in robot.waits])
    sessions = {robot.session_id for robot in robots if robot.session_id}
    figures = {
        "robots": float(len(robots)),
        "ended": float(sum(robot.state in ("converged", "exhausted") for robot in robots)),
        "converged": float(sum(robot.state == "converged" for robot in robots)),
        "mixed": float(sum(bool(robot.mixed) for robot in robots) + len(robots) - len(sessions)),
        "scans": float(sum(robot.scans for robot in robots)),
        "median error mm": 1000 * float(np.nanmedian([robot.error for robot in robots])),
        "all ended after s": wall,
        "calls": float(len(waits)),
        "median wait s": float(np.median(waits)),
        "p95 wait s": float(np.percentile(waits, 95)),
        "worst wait s": float(waits.max()),
        **{f"obeyed {name}": float(count) for name, count in sorted(obeyed.items())},
    }
    for name, usage in sorted(after.items()):
        figures[f"{name} peak MB"] = usage.peak / 1e6
        figures[f"{name} CPU-s a session"] = (usage.seconds - before[name].seconds) / len(robots)
    return figures


def _count_repetitions() -> Counter[str]:
    """Counts from now on, by the error's name, how often the SDK was told to come back and did."""
    counted: Counter[str] = Counter()
    delay_after, lock = Attempts.delay_after, threading.Lock()

    def count(attempts: Attempts, error: PretouchError, reached: bool = False) -> float:
        delay = delay_after(attempts, error, reached)
        with lock:
            counted[type(error).__name__] += 1
        return delay

    Attempts.delay_after = count  # type: ignore[method-assign, assignment]
    return counted


if __name__ == "__main__":
    sys.exit(main())
