"""What a page of the list of sessions takes: `python -m benchmarks.session_list [--kept 25 10000]`.

The orchestrator is a real one with SQLite before services that answer by formula (those of the tests). All its sessions
are copies of one after a scan. Each page is asked for over REST, as the dashboard does; all pages are walked once.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import httpx
import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from helpers.fake_upstream import FakeUpstream
from helpers.processes import Orchestrator
from helpers.rest_sessions import opened, scanned
from pretouch_orchestrator.store import open_store
from pretouch_orchestrator.store.protocol import NewEvent

_PAGE = 25
_TIMES = 50


def measure(kept: int) -> dict[str, float]:
    """Milliseconds of the first page (median, 95 % quantile) and of the slowest of all, its kB, and sessions seen."""
    with (
        tempfile.TemporaryDirectory() as folder,
        FakeUpstream() as upstream,
        Orchestrator(Path(folder), upstream.address) as orchestrator,
    ):
        with httpx.Client(base_url=orchestrator.rest_url, timeout=300, trust_env=False) as rest:
            model = scanned(rest, opened(rest))["id"]
        orchestrator.stop()
        asyncio.run(_copy(f"sqlite:{folder}", model, kept - 1))
        orchestrator.start()
        with httpx.Client(base_url=orchestrator.rest_url, timeout=300, trust_env=False) as rest:
            first = [_ask(rest, None)[1] for _ in range(_TIMES)]
            seen, slowest, cursor, size = 0, 0.0, None, 0
            while True:
                answer, took = _ask(rest, cursor)
                page = answer.json()
                seen, slowest = seen + len(page["sessions"]), max(slowest, took)
                size = max(size, len(answer.content))
                if (cursor := page["next"]) is None:
                    break
    return {
        "first page p50 ms": 1000 * float(np.percentile(first, 50)),
        "first page p95 ms": 1000 * float(np.percentile(first, 95)),
        "slowest page ms": 1000 * slowest,
        "largest page kB": size / 1000,
        "sessions seen": seen,
    }


def _ask(rest: httpx.Client, cursor: str | None) -> tuple[httpx.Response, float]:
    began = time.perf_counter()
    answer = rest.get("/v1/sessions", params={"limit": _PAGE} | ({"cursor": cursor} if cursor else {}))
    took = time.perf_counter() - began
    answer.raise_for_status()
    return answer, took


async def _copy(address: str, model: str, copies: int) -> None:
    async with open_store(address) as store:
        record = await store.load_record("", model, None)
        events = [NewEvent(event.type, event.data) for event in await store.load_events(model, 0)]
        for count in range(copies):
            await store.create("", replace(record, id=f"kept{count}"), events, None)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kept", type=int, nargs="+", default=[25, 10_000])
    for number in parser.parse_args().kept:
        for name, value in measure(number).items():
            print(f"{number:6} kept, {name:20} {value:10.2f}", flush=True)
