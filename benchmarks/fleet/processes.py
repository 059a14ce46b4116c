"""The fleet as processes of this machine, with every link between them cuttable."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from signal import Signals
from typing import Self

import httpx

from benchmarks.fleet.links import Flow, Link, Network
from benchmarks.fleet.parts import Fault
from benchmarks.fleet.postgres import Postgres
from benchmarks.fleet.supervised import Supervised
from benchmarks.running_service import free_port

_READY_WITHIN = 300.0
_SERVICE_FAULTS = tuple(Fault)
_POSTGRES_FAULTS = (Fault.KILL, Fault.FREEZE, Fault.DROP, Fault.BLACKHOLE)
_FLOWS = {Fault.DROP: Flow.DROPPED, Fault.BLACKHOLE: Flow.LOST}


class ProcessFleet:
    """Orchestrators on one PostgreSQL, with registrars and detectors behind them, and robots' one way in; use it in a
    `with` block.

    Args:
        folder: of the database and the logs.
        variables: more of every service's environment.
    """

    def __init__(
        self,
        folder: Path,
        orchestrators: int = 2,
        registrars: int = 3,
        detectors: int = 2,
        variables: Mapping[str, str] | None = None,
    ) -> None:
        self._folder = folder
        self._variables = variables or {}
        self._counts = {"orchestrator": orchestrators, "registrar": registrars, "detector": detectors}
        self.parts: Sequence[str] = ("postgres", *(part for kind in self._counts for part in self._names(kind)))
        self._services: dict[str, Supervised] = {}
        self._links: list[tuple[set[str], Link]] = []
        self._stack = ExitStack()
        self.rest = self.grpc = ""

    def __enter__(self) -> Self:
        with self._stack:
            self._network = self._stack.enter_context(Network())
            self._postgres = Postgres(self._folder / "postgres")
            self._stack.callback(self._postgres.close)
            ports = {part: free_port() for part in self.parts[1:]}
            for part in (*self._names("registrar"), *self._names("detector")):
                self._serve(part, {"PRETOUCH_PORT": str(ports[part])})
            rest_ports = {part: free_port() for part in self._names("orchestrator")}
            for part in self._names("orchestrator"):
                own = {"REST_PORT": str(rest_ports[part]), "STORE": self._store_of(part)}
                for kind in ("registrar", "detector"):
                    links = [self._link({part, other}, ports[other]) for other in self._names(kind)]
                    own[kind.upper()] = ",".join(f"127.0.0.1:{link.port}" for link in links)
                variables = {f"PRETOUCH_ORCHESTRATOR_{key}": value for key, value in own.items()}
                self._serve(part, variables | {"PRETOUCH_PORT": str(ports[part])})
            ways = {part: self._link({part}, rest_ports[part]) for part in self._names("orchestrator")}
            grpc_ways = {part: self._link({part}, ports[part]) for part in self._names("orchestrator")}
            health = [f"http://127.0.0.1:{way.port}/healthz" for way in ways.values()]
            entries = [
                self._network.link([("127.0.0.1", way.port) for way in each.values()], health)
                for each in (ways, grpc_ways)
            ]
            self.rest, self.grpc = f"http://127.0.0.1:{entries[0].port}", f"127.0.0.1:{entries[1].port}"
            self._wait_until_ready([f"http://127.0.0.1:{way.port}/readyz" for way in ways.values()])
            self._stack = self._stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def faults(self, part: str) -> Sequence[Fault]:
        return _POSTGRES_FAULTS if part == "postgres" else _SERVICE_FAULTS

    def break_part(self, part: str, fault: Fault) -> None:
        if fault in _FLOWS:
            self._set_flow(part, _FLOWS[fault])
            return
        number = Signals.SIGSTOP if fault in (Fault.FREEZE, Fault.HANG) else Signals.SIGKILL
        if part == "postgres":
            self._postgres.send(number)
        elif fault in (Fault.KILL, Fault.FREEZE):
            self._services[part].send(number)
        else:
            self._services[part].send_to_service(number)

    def mend_part(self, part: str, fault: Fault) -> None:
        if fault in _FLOWS:
            self._set_flow(part, Flow.OPEN)
        elif fault is Fault.FREEZE:
            send = self._postgres.send if part == "postgres" else self._services[part].send
            send(Signals.SIGCONT)
        elif part == "postgres":
            self._postgres.start()

    def restarts(self) -> dict[str, int]:
        return {part: service.restarts() for part, service in self._services.items()}

    def _names(self, kind: str) -> list[str]:
        return [f"{kind}-{k}" for k in range(1, self._counts[kind] + 1)]

    def _serve(self, part: str, variables: Mapping[str, str]) -> None:
        log = self._folder / f"{part}.log"
        service = Supervised(part.partition("-")[0], dict(self._variables) | dict(variables), log)
        self._stack.callback(service.close)
        self._services[part] = service

    def _link(self, ends: set[str], port: int) -> Link:
        link = self._network.link([("127.0.0.1", port)])
        self._links.append((ends, link))
        return link

    def _store_of(self, part: str) -> str:
        link = self._network.link([self._postgres.socket])
        self._links.append(({part, "postgres"}, link))
        return f"postgresql://postgres@127.0.0.1:{link.port}/postgres"

    def _set_flow(self, part: str, flow: Flow) -> None:
        self._network.set_flow([link for ends, link in self._links if part in ends], flow)

    def _wait_until_ready(self, urls: Sequence[str]) -> None:
        end = time.monotonic() + _READY_WITHIN
        for url in urls:
            while True:
                try:
                    answer = httpx.get(url, trust_env=False, timeout=10.0)
                    if answer.status_code == 200:
                        break
                    said = answer.text
                except httpx.HTTPError as error:
                    said = str(error)
                if time.monotonic() > end:
                    raise RuntimeError(f"The fleet is not ready: {said}; its logs are in {self._folder}.")
                time.sleep(0.2)
