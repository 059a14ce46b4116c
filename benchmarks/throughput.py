"""Scans a second of orchestrators on one PostgreSQL and registrars, and the processor seconds that each scan takes.

    python -m benchmarks.throughput [--orchestrators 1 2] [--registrars 1 2 4] [--robots 8] [--seconds 60] [--json OUT]

Robots run whole sessions over REST without any delay, each on one of the orchestrators, with samples that were
simulated before. `--stub` puts a proxy before the registrar that remembers its answers, and all sessions repeat those
of a first round: what is left is what the orchestrators themselves need.
"""

from __future__ import annotations

import argparse
import itertools
import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import psutil
from pretouch_simulation.demo import request_for
from pretouch_simulation.fingers.ideal import ThinBeam
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import Case, generator, make_case
from pretouch_simulation.scanning import scan_along

from benchmarks.fleet.postgres import Postgres
from benchmarks.running_service import free_port, processor_seconds, service
from pretouch.client import RestClient
from pretouch.session import ScanPlan
from pretouch.tof import RangeSamples

_FINGER = ThinBeam()
_OBJECTS = 3
_ROUNDS_OF_STUB = 3
"""Sessions on each object before the measurement: the first sends scenes, the second does not, the third repeats it."""
ROBOTS, STEPS_A_SECOND = 1000, 0.1


class Fleet:
    """The services of one configuration; use it in a `with` block.

    Attributes:
        urls: the orchestrators' REST APIs.
        processes: those of each kind of service.
    """

    def __init__(self, folder: Path, orchestrators: int, registrars: int, *, stub: bool) -> None:
        self.urls: list[str] = []
        self.processes: dict[str, list[psutil.Process]] = {"registrar": [], "orchestrator": []}
        self._stack = ExitStack()
        self._folder, self._counts, self._stub = folder, (orchestrators, registrars), stub

    def __enter__(self) -> Fleet:
        with self._stack:
            postgres = Postgres(self._folder / "postgres")
            self._stack.callback(postgres.close)
            self.processes["postgres"] = [psutil.Process(postgres.pid)]
            detector = self._serve("detector")
            registrars = [self._serve("registrar") for _ in range(self._counts[1])]
            if self._stub:
                registrars = [self._remember(address) for address in registrars]
            for _ in range(self._counts[0]):
                rest = free_port()
                self._serve(
                    "orchestrator",
                    PRETOUCH_ORCHESTRATOR_DETECTOR=detector,
                    PRETOUCH_ORCHESTRATOR_REGISTRAR=",".join(registrars),
                    PRETOUCH_ORCHESTRATOR_STORE=f"postgresql://postgres@/postgres?host={postgres.socket.parent}",
                    PRETOUCH_ORCHESTRATOR_REST_PORT=str(rest),
                )
                self.urls.append(f"http://127.0.0.1:{rest}")
            self._stack = self._stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def spent(self) -> dict[str, float]:
        """Processor seconds so far, by kind of service; `robots` is this process."""
        spent = {kind: sum(map(processor_seconds, processes)) for kind, processes in self.processes.items()}
        times = psutil.Process().cpu_times()
        return spent | {"robots": times.user + times.system}

    def _serve(self, name: str, **variables: str) -> str:
        port = free_port()
        process = self._stack.enter_context(service(name, PRETOUCH_PORT=str(port), **variables))
        self.processes.setdefault(name, []).append(process)
        return f"127.0.0.1:{port}"

    def _remember(self, address: str) -> str:
        port = free_port()
        proxy = subprocess.Popen([sys.executable, "-m", "benchmarks.remembering_proxy", str(port), address])
        self._stack.callback(proxy.wait)
        self._stack.callback(proxy.terminate)
        self.processes.setdefault("proxy", []).append(psutil.Process(proxy.pid))
        return f"127.0.0.1:{port}"


class Fingers:
    """Samples of each object's scans: the sessions on an object are all the same, so that each is simulated once."""

    def __init__(self) -> None:
        self._done: dict[tuple[str, str], RangeSamples] = {}

    def scan(self, case: Case, plan: ScanPlan) -> RangeSamples:
        key = (case.name, plan.scan_id)
        if key not in self._done:
            rng = generator("finger", *key)
            self._done[key] = scan_along(case.world, plan.path, _FINGER.sensor, _FINGER, rng)
        return self._done[key]


def run_session(client: RestClient, case: Case, fingers: Fingers, end: float = float("inf")) -> int:
    """Runs a session to its end or until `end` (time.monotonic); its scans."""
    scans = 0
    session = client.create_session(request_for(case, _FINGER.sensor), case.depth.metres, case.mask)
    while session.next_scan is not None and time.monotonic() < end:
        session = client.submit(session.id, session.next_scan.scan_id, fingers.scan(case, session.next_scan))
        scans += 1
    return scans


def measure(fleet: Fleet, cases: Sequence[Case], robots: int, seconds: float, rounds: int) -> dict[str, float]:
    """Scans a second, and milliseconds of a processor for each scan by kind of service, after `rounds` of sessions."""
    fingers = Fingers()
    for _, case, url in itertools.product(range(rounds), cases, fleet.urls):
        with RestClient(url, timeout=300.0) as client:
            run_session(client, case, fingers)
    scans = [0] * robots
    end = time.monotonic() + seconds

    def run(number: int) -> None:
        with RestClient(fleet.urls[number % len(fleet.urls)], timeout=300.0) as client:
            for case in itertools.cycle([*cases[number % len(cases) :], *cases[: number % len(cases)]]):
                if time.monotonic() > end:
                    return
                scans[number] += run_session(client, case, fingers, end)

    threads = [threading.Thread(target=run, args=(number,)) for number in range(robots)]
    before, began = fleet.spent(), time.monotonic()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    wall, after = time.monotonic() - began, fleet.spent()
    taken = {kind: after[kind] - before[kind] for kind in after}
    figures = {"scans/s": sum(scans) / wall, "processors busy": sum(taken.values()) / wall}
    return figures | {f"{kind} ms/scan": 1000 * each / sum(scans) for kind, each in taken.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--orchestrators", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--registrars", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--stub", action="store_true", help="a registrar that remembers its answers")
    parser.add_argument("--robots", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    arguments = parser.parse_args()
    cases = [make_case(name, maker(), 0) for name, maker in list(MAKERS.items())[:_OBJECTS]]
    rounds, rows = _ROUNDS_OF_STUB if arguments.stub else 1, []
    for orchestrators, registrars in itertools.product(arguments.orchestrators, arguments.registrars):
        with (
            tempfile.TemporaryDirectory(prefix="pretouch-throughput-") as folder,
            Fleet(Path(folder), orchestrators, registrars, stub=arguments.stub) as fleet,
        ):
            figures = measure(fleet, cases, arguments.robots, arguments.seconds, rounds)
        rows.append({"orchestrators": float(orchestrators), "registrars": float(registrars)} | figures)
        print("  ".join(f"{name} {value:.1f}" for name, value in rows[-1].items()), flush=True)
        print(
            f"  {ROBOTS} robots at a scan in {1 / STEPS_A_SECOND:.0f} s need, in processors: "
            + ", ".join(
                f"{name.split()[0]} {value / 1000 * ROBOTS * STEPS_A_SECOND:.1f}"
                for name, value in figures.items()
                if name.endswith("ms/scan")
            ),
            flush=True,
        )
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
