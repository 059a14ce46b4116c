"""What the session store costs: `python -m benchmarks.store [--json OUT]`. Takes some two minutes.

The orchestrator is a real one before services that answer by formula (those of the tests).

- Bytes that the orchestrator reads and writes in each call of a session on a depth image of 4 megapixels, which the
  object and its surroundings fill. With PostgreSQL: the server's log, which holds what is written.
- What the store takes of a step, of a `GET` and of adding up what it holds, with one session and with KEPT in it, in
  turns; and kB of a session on a small image after one scan.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
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
from pretouch_orchestrator.store import open_store
from pretouch_orchestrator.store.protocol import NewEvent

KEPT = 1000
_STEPS = 200
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
    """Milliseconds that the store takes of a step where it keeps one session and KEPT, in turns; kB of a session."""
    with tempfile.TemporaryDirectory() as folder, started(addresses and addresses[0]) as orchestrator:
        with httpx.Client(base_url=orchestrator.rest_url, timeout=300) as rest:
            model = scanned(rest, opened(rest))
        orchestrator.stop()
        few, many = addresses or (f"sqlite:{orchestrator.state}", f"sqlite:{folder}")
        return asyncio.run(_compare_stores(few, many, model["id"]))


async def _compare_stores(few: str, many: str, model: str) -> dict[str, float]:
    async with open_store(few) as small, open_store(many) as large:
        record = await small.load_record("", model, None)
        events = [NewEvent(event.type, event.data) for event in await small.load_events(model, 0)]
        table = record.scene.table
        for count in range(KEPT):
            scene = replace(record.scene, table=replace(table, offset=table.offset + 1e-6 * (count + 1)))
            await large.create("", replace(record, id=f"kept{count}", scene=scene), events, None)
        figures = {"kB a session": await large.used_bytes() / KEPT / 1000}
        records = {small: record, large: await large.create("", record, events, None)}
        seconds: dict[str, list[float]] = {}
        for _ in range(_STEPS):
            for store, name in ((small, "1 kept"), (large, f"{KEPT} kept")):
                start = time.perf_counter()
                await store.acquire_lease(record.id, "benchmark", 10.0)
                known = await store.load_record("", record.id, records[store])
                records[store] = await store.update(known, known, events[-3:], "benchmark")
                await store.release_lease(record.id, "benchmark")
                between = time.perf_counter()
                await store.load_session("", record.id)
                read = time.perf_counter()
                await store.used_bytes()
                for part, took in (
                    ("step", between - start),
                    ("get", read - between),
                    ("sum", time.perf_counter() - read),
                ):
                    seconds.setdefault(f"{name}: {part}", []).append(took)
    for name, values in seconds.items():
        for quantile in (50, 95):
            figures[f"{name} p{quantile} ms"] = 1000 * float(np.percentile(values, quantile))
    return figures


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
        parts: dict[str, tuple[Callable[[], dict[str, float]], ...]] = {
            "SQLite": (measure_bytes, measure_growth),
            "PostgreSQL": (lambda: measure_bytes(few), lambda: measure_growth((few, many))),
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
