"""What the session store costs: `python -m benchmarks.store [--json OUT]`. Takes some five minutes.

A real orchestrator before services that answer by formula (those of the tests), so that the store and the planner are
all that is measured.

- Bytes that the orchestrator reads and writes in each call of a session on a depth image of 4 megapixels, which the
  object and its surroundings fill. With PostgreSQL: the server's log, which holds what is written.
- Scans of sessions on small images, with few and with KEPT others in the store, in turns: milliseconds; bytes of each.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from helpers import box_view
from helpers.fake_upstream import FakeUpstream
from helpers.processes import Orchestrator
from helpers.rest_sessions import opened, scan_path, scanned

KEPT = 1000
_STEPS = 40
_SIDE, _FOCAL = 2000, 2800.0


def large_session() -> dict[str, tuple[str, bytes, str]]:
    """A box of 8 x 8 x 5 cm on a table, seen from 70 cm straight above: the whole image is near the object."""
    camera = {"fx": _FOCAL, "fy": _FOCAL, "cx": (_SIDE - 1) / 2, "cy": (_SIDE - 1) / 2, "depth_scale": 0.0001}
    pose = {"translation": [0.4, 0.0, 0.7], "rotation": [1.0, 0.0, 0.0, 0.0]}
    depth, mask = np.full((_SIDE, _SIDE), 7000, np.uint16), np.zeros((_SIDE, _SIDE), np.uint8)
    half = int(0.04 / 0.65 * _FOCAL)
    window = np.s_[_SIDE // 2 - half : _SIDE // 2 + half, _SIDE // 2 - half : _SIDE // 2 + half]
    depth[window], mask[window] = 6500, 255
    request = {"camera": camera, "base_T_camera": pose, "budget": {"fraction": 1.0}}
    return {
        "request": ("request.json", json.dumps(request).encode(), "application/json"),
        "depth": ("depth.png", box_view.png(depth), "image/png"),
        "mask": ("mask.png", box_view.png(mask), "image/png"),
    }


class Traffic:
    """Counts what a process reads and writes by system calls on files, and what PostgreSQL writes to its log."""

    def __init__(self, orchestrator: Orchestrator, database: str | None) -> None:
        self._orchestrator = orchestrator
        self._database = database

    @contextmanager
    def counted(self, figures: dict[str, float], name: str) -> Iterator[None]:
        """Adds MB read and written within the block to the figures."""
        before = self._read()
        yield
        for kind, megabytes in self._read().items():
            figures[f"{name}: {kind}"] = megabytes - before[kind]

    def _read(self) -> dict[str, float]:
        process = self._orchestrator._process
        assert process is not None
        lines = Path(f"/proc/{process.pid}/io").read_text().splitlines()
        counts = {key: int(value) / 1e6 for key, value in (line.split(": ") for line in lines)}
        # What sockets take is in rchar and wchar too, but the calls of a step are small.
        figures = {"read MB": counts["rchar"], "written MB": counts["write_bytes"]}
        if self._database is not None:
            import psycopg

            with closing(psycopg.connect(self._database)) as connection:
                ((position,),) = connection.execute("SELECT pg_current_wal_insert_lsn() - '0/0'").fetchall()
            figures["log MB"] = float(position) / 1e6
        return figures


def measure_bytes(database: str | None = None) -> dict[str, float]:
    """MB of each call of a session on 4 megapixels."""
    figures: dict[str, float] = {}
    with started(database) as orchestrator, httpx.Client(base_url=orchestrator.rest_url, timeout=300) as rest:
        traffic = Traffic(orchestrator, database)
        with traffic.counted(figures, "creation"):
            session = rest.post("/v1/sessions", files=large_session()).json()
        with traffic.counted(figures, "first scan"):
            session = scanned(rest, session)
        samples = box_view.samples(session["next_scan"])["samples"]
        with traffic.counted(figures, "telling"):
            rest.post(f"{scan_path(session)}/samples", json={"from": 0, "samples": samples[:5]}).raise_for_status()
        with traffic.counted(figures, "second scan"):
            session = rest.post(scan_path(session), json={"samples": samples[5:]}).json()
        orchestrator.stop()
        orchestrator.start()
        with traffic.counted(figures, "scan after a restart"):
            session = scanned(rest, session)
        session = rest.post("/v1/sessions", files=large_session()).json()
        orchestrator.stop()
        orchestrator.start()
        with traffic.counted(figures, "cancellation"):
            rest.delete(f"/v1/sessions/{session['id']}").raise_for_status()
    return figures


def measure_growth(addresses: tuple[str, str] | None = None) -> dict[str, float]:
    """Milliseconds of scans in a store with few sessions and in one with KEPT, in turns; kB that each session takes."""
    figures: dict[str, float] = {}
    with ExitStack() as stack:
        few, many = (stack.enter_context(started(address)) for address in addresses or (None, None))
        clients = [stack.enter_context(httpx.Client(base_url=each.rest_url, timeout=300)) for each in (few, many)]
        model = scanned(clients[1], opened(clients[1]))
        many.stop()
        used = asyncio.run(_fill(addresses[1] if addresses else f"sqlite:{many.state}", model["id"]))
        many.start()
        seconds: dict[str, list[float]] = {}
        sessions: list[dict[str, Any] | None] = [None, None]
        for turn in range(2 * _STEPS):
            name, rest = ("few kept", f"{KEPT} kept")[turn % 2], clients[turn % 2]
            session = sessions[turn % 2]
            if session is None or session["next_scan"] is None:
                session = opened(rest)
            body, path = box_view.samples(session["next_scan"]), scan_path(session)
            start = time.perf_counter()
            sessions[turn % 2] = rest.post(path, json=body).json()
            between = time.perf_counter()
            rest.get(f"/v1/sessions/{session['id']}").raise_for_status()
            seconds.setdefault(f"{name}: scan", []).append(between - start)
            seconds.setdefault(f"{name}: get", []).append(time.perf_counter() - between)
        for name, values in seconds.items():
            for quantile in (50, 95):
                figures[f"{name} p{quantile} ms"] = 1000 * float(np.percentile(values, quantile))
    return figures | {"kB a session": used / 1000}


async def _fill(store_address: str, model: str) -> float:
    """Adds KEPT sessions, each with a scene of its own; bytes for each."""
    from pretouch_orchestrator.store import open_store
    from pretouch_orchestrator.store.protocol import NewEvent

    async with open_store(store_address) as store:
        record = await store.load_record("", model, None)
        events = [NewEvent(event.type, event.data) for event in await store.load_events(model, 0)]
        before = await store.used_bytes()
        table = record.scene.table
        for count in range(KEPT):
            scene = replace(record.scene, table=replace(table, offset=table.offset + 1e-6 * (count + 1)))
            await store.create("", replace(record, id=f"kept{count}", scene=scene), events, None)
        return (await store.used_bytes() - before) / KEPT


@contextmanager
def started(database: str | None) -> Iterator[Orchestrator]:
    """An orchestrator on a new SQLite file, or on the database."""
    variables: dict[str, Any] = {} if database is None else {"PRETOUCH_ORCHESTRATOR_STORE": database}
    with (
        tempfile.TemporaryDirectory() as folder,
        FakeUpstream() as upstream,
        Orchestrator(Path(folder), upstream.address, **variables) as orchestrator,
    ):
        yield orchestrator


def measure() -> dict[str, float]:
    """All figures, of SQLite and PostgreSQL; each is printed when it is known."""
    from helpers.postgresql import PostgresqlServer

    figures: dict[str, float] = {}
    with PostgresqlServer() as server:
        few, many = server.new_database(), server.new_database()
        parts = {
            "SQLite": (measure_bytes, measure_growth),
            "PostgreSQL": (lambda: measure_bytes(server.new_database()), lambda: measure_growth((few, many))),
        }
        for name, measurements in parts.items():
            for measure_part in measurements:
                for figure, value in measure_part().items():
                    figures[f"{name}, {figure}"] = value
                    print(f"{name}, {figure:40} {value:10.3f}", flush=True)
    return figures


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    out = parser.parse_args().json
    measured = measure()
    if out:
        out.write_text(json.dumps(measured, indent=1) + "\n")
