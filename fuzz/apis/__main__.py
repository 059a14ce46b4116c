"""Fuzzes REST and gRPC of a `pretouch up` of its own: `python -m fuzz.apis [--seconds 600] [--seed 0]`.

It ends with 1 if an invariant was broken, and says which; the messages of a gRPC call that broke one are left in the
working directory.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import psutil
from hypothesis.errors import HypothesisDeprecationWarning
from pretouch_simulation.finger_link import FingerProcess
from pretouch_simulation.services import Services

from benchmarks.service_usage import Usage, read_usage
from fuzz.apis.counts import Counts
from fuzz.apis.rest import fuzz_rest
from fuzz.apis.rpc import fuzz_rpc
from fuzz.apis.seeds import DEVICE, FINGER, case, small_request
from pretouch.client import RestClient

_CEILING = 4_000_000_000
"""Bytes that no service may exceed."""
_DEFECTS = ("Traceback (most recent call last)", "met a defect", "a service is restarted")
_GRPC_THREADS = 2


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600.0, help="how long to fuzz")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    warnings.filterwarnings("ignore", category=HypothesisDeprecationWarning)  # other threads draw random numbers too
    counts = Counts()
    with tempfile.TemporaryDirectory(prefix="pretouch-") as folder:
        world = Path(folder) / "world.npz"
        case().world.save(world)
        with FingerProcess.in_world(world, "ideal", arguments.seed, FINGER.sensor.rate) as finger:
            environment = {"PRETOUCH_LOG_LEVEL": "warning"}
            with Services([f"{DEVICE}={finger.port}"], environment) as services:
                before = read_usage(services.pid)
                _fuzz(services, before, counts, arguments.seed, arguments.seconds)
                _check_end(services, before, counts)
    print(*counts.lines(), sep="\n")
    if not counts.add_up():
        counts.fault("requests and answers do not add up")
    for number, (fault, times) in enumerate(counts.faults.most_common()):
        print(f"BROKEN {times}x {fault}")
        for place, data in enumerate(counts.inputs.get(fault, ())):
            Path(f"fault-{number}-{place}.bin").write_bytes(data)
    print("an invariant is broken" if counts.faults else "all invariants hold")
    return 1 if counts.faults else 0


def _fuzz(services: Services, before: dict[str, Usage], counts: Counts, seed: int, seconds: float) -> None:
    end = time.monotonic() + seconds
    addresses = {
        "Orchestrator": services.grpc,
        "SensorGateway": services.gateway,
        "Detector": _find_address(before["detector"].pid),
        "Registrar": _find_address(before["registrar"].pid),
    }

    def over() -> bool:
        return time.monotonic() > end

    threads = [_Worker(lambda: fuzz_rest(services.rest, counts, seed, over))]
    threads += [
        _Worker(lambda number=number: fuzz_rpc(addresses, counts, seed + number, over))  # type: ignore[misc]
        for number in range(_GRPC_THREADS)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
        if thread.failure is not None:
            raise thread.failure


class _Worker(threading.Thread):
    """Runs `work`, and keeps what it raises."""

    def __init__(self, work: Callable[[], None]) -> None:
        super().__init__(daemon=True)
        self._work = work
        self.failure: BaseException | None = None

    def run(self) -> None:
        try:
            self._work()
        except BaseException as error:
            self.failure = error


def _find_address(pid: int) -> str:
    """Where a service listens for gRPC."""
    listening = [each.laddr for each in psutil.Process(pid).net_connections() if each.status == psutil.CONN_LISTEN]
    return f"127.0.0.1:{min(address.port for address in listening)}"


def _check_end(services: Services, before: dict[str, Usage], counts: Counts) -> None:
    """The same processes still serve, within their memory, and the log names no defect."""
    after = read_usage(services.pid)
    for name, was in before.items():
        if name not in after or after[name].pid != was.pid:
            counts.fault(f"the {name} ended or was restarted")
    for name, usage in after.items():
        print(f"{name:14} peak {usage.peak / 1e6:6.0f} MB, {usage.seconds - before[name].seconds:7.1f} CPU-s")
        if usage.peak > _CEILING:
            counts.fault(f"the {name} held {usage.peak / 1e6:.0f} MB")
    with RestClient(services.rest, timeout=120.0) as client:
        client.cancel(client.create_session(*small_request()).id)
    for line in services.log.read_text(errors="replace").splitlines():
        if any(word in line for word in _DEFECTS):
            counts.fault(f"the log says: {_shorten(line)}")


def _shorten(line: str) -> str:
    """A log line without what differs from one time to the next."""
    try:
        fields = json.loads(line)
    except ValueError:
        return line[:300]
    trace = str(fields.get("exception", "")).strip().splitlines()
    places = [line.strip().rpartition("/")[2] for line in trace if 'File "' in line and "/pretouch" in line]
    what = [*places[-4:], *trace[-1:]]
    return " | ".join([f"{fields.get('service')}: {fields.get('event')} {fields.get('method', '')}", *what])


if __name__ == "__main__":
    sys.exit(main())
