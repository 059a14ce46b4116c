"""What a session costs two registrars, in processor seconds and in bytes sent to them, and how the sessions are shared.

    python -m benchmarks.registrar_copies [--registrars 2] [--sessions 24] [--address LIST]

`--address` takes what PRETOUCH_ORCHESTRATOR_REGISTRAR is set to, with {0}, {1}, .. for the copies' addresses; left out,
all of them, separated by commas.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import tempfile
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import numpy as np
from pretouch_simulation.demo import request_for
from pretouch_simulation.fingers.ideal import ThinBeam
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import Case, generator, make_case
from pretouch_simulation.scanning import scan_along

from benchmarks.running_service import free_port, processor_seconds, service
from pretouch.client import RestClient

_FINGER = ThinBeam()


class CountingProxy:
    """Passes connections on to a port, and counts the bytes that go there."""

    def __init__(self, behind: int) -> None:
        self.behind = behind
        self.sent = 0
        self.port = free_port()
        self._loop = asyncio.new_event_loop()
        threading.Thread(target=self._loop.run_until_complete, args=(self._serve(),), daemon=True).start()

    async def _serve(self) -> None:
        await asyncio.start_server(self._accept, "127.0.0.1", self.port)
        await asyncio.Event().wait()

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        back, forth = await asyncio.open_connection("127.0.0.1", self.behind)
        await asyncio.gather(self._pump(reader, forth, counted=True), self._pump(back, writer, counted=False))

    async def _pump(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, *, counted: bool) -> None:
        while data := await reader.read(1 << 16):
            self.sent += len(data) if counted else 0
            writer.write(data)
            await writer.drain()
        writer.close()


def run_session(url: str, case: Case) -> int:
    """Runs one session to its end; the number of scans."""
    rng, scans = generator("finger", case.name), 0
    with RestClient(url, timeout=120.0) as client:
        session = client.create_session(request_for(case, _FINGER.sensor), case.depth.metres, case.mask)
        while session.next_scan is not None:
            samples = scan_along(case.world, session.next_scan.path, _FINGER.sensor, _FINGER, rng)
            session = client.submit(session.id, session.next_scan.scan_id, samples)
            scans += 1
    return scans


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--registrars", type=int, default=2)
    parser.add_argument("--sessions", type=int, default=24)
    parser.add_argument("--address")
    arguments = parser.parse_args()
    cases = [make_case(name, maker(), 0, seed) for seed in range(10) for name, maker in MAKERS.items()]
    cases = cases[: arguments.sessions]
    with ExitStack() as stack:
        ports = {name: free_port() for name in ("detector", "orchestrator", "rest")}
        stack.enter_context(service("detector", PRETOUCH_PORT=str(ports["detector"])))
        proxies = [CountingProxy(free_port()) for _ in range(arguments.registrars)]
        registrars = [stack.enter_context(service("registrar", PRETOUCH_PORT=str(each.behind))) for each in proxies]
        addresses = [f"127.0.0.1:{each.port}" for each in proxies]
        listed = arguments.address.format(*addresses) if arguments.address else ",".join(addresses)
        stack.enter_context(
            service(
                "orchestrator",
                PRETOUCH_PORT=str(ports["orchestrator"]),
                PRETOUCH_ORCHESTRATOR_DETECTOR=f"127.0.0.1:{ports['detector']}",
                PRETOUCH_ORCHESTRATOR_REGISTRAR=listed,
                PRETOUCH_ORCHESTRATOR_STATE=stack.enter_context(tempfile.TemporaryDirectory()),
                PRETOUCH_ORCHESTRATOR_REST_PORT=str(ports["rest"]),
            )
        )
        before = [processor_seconds(process) for process in registrars]
        with ThreadPoolExecutor(2) as pool:
            scans = list(pool.map(lambda case: run_session(f"http://127.0.0.1:{ports['rest']}", case), cases))
        seconds = np.array([processor_seconds(process) for process in registrars]) - before
    sent = [each.sent for each in proxies]
    figures = {
        "sessions": len(cases),
        "scans a session": float(np.mean(scans)),
        "CPU s a session": float(seconds.sum() / len(cases)),
        "kB to registrars a session": sum(sent) / 1000 / len(cases),
        "share of the busiest registrar": float(seconds.max() / seconds.sum()),
    }
    print(json.dumps(figures, indent=1))


main()
