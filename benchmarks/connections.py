"""What clients that hold connections cost the others: `python -m benchmarks.connections [--kind KIND] [--json OUT]`.

One orchestrator as a process of its own, with a limit of 1,024 open files, is held by N connections of one kind after
the other, while a good client asks over a new connection ten times a second:

    headers   half a request's head, then nothing
    drip      the same, and a byte of it every second
    body      a whole head that announces 1 MB, then ten bytes
    unread    documents are asked for a hundred times over, and no answer is read
    grpc      connections to the gRPC port, and nothing on them

Of each kind: the good client's answers and their times, how many of the connections the service still holds at the end,
how many lines and bytes it logged, and the memory that it holds then.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import resource
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import httpx
import numpy as np
import psutil

CONNECTIONS = 1100
SECONDS = 30.0
OPEN_FILES = 1024
_HALF_HEAD = b"GET /v1/sessions HTTP/1.1\r\nHost: 127.0.0.1\r\nX-More: "
_HALF_BODY = (
    b"POST /v1/sessions HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: multipart/form-data; boundary=x\r\n"
    b"Content-Length: 1000000\r\n\r\n0123456789"
)
_UNREAD = b"GET /openapi.json HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" * 100
KINDS = {"headers": _HALF_HEAD, "drip": _HALF_HEAD, "body": _HALF_BODY, "unread": _UNREAD, "grpc": b""}
"""What is sent on each connection at once."""
_ASK_EVERY, _PATIENCE = 0.1, 5.0  # s
_READY_WITHIN = 120.0


@dataclass
class Held:
    """A connection of the attack; `open` until the service closes it."""

    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    parser.add_argument("--connections", type=int, default=CONNECTIONS)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--kind", choices=KINDS, action="append", help="only this kind; may be repeated")
    arguments = parser.parse_args()
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    rows = []
    for kind in arguments.kind or KINDS:
        rows.append(asyncio.run(measure(kind, arguments.connections, arguments.seconds)))
        print(" | ".join(f"{name} {value}" for name, value in rows[-1].items()), flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1) + "\n")


async def measure(kind: str, connections: int, seconds: float) -> dict[str, float | str]:
    """The figures of one kind of attack."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log"
        process, rest, grpc = await _start(Path(folder), log)
        try:
            memory = psutil.Process(process.pid).memory_info().rss
            logged = len(log.read_bytes())
            held: list[Held] = []
            attack = asyncio.create_task(_attack(grpc if kind == "grpc" else rest, kind, connections, held))
            answers = await _ask(f"http://127.0.0.1:{rest}/v1/sessions", seconds)
            service = psutil.Process(process.pid)
            open_still = sum(one.status == "ESTABLISHED" for one in service.net_connections("tcp"))
            after = service.memory_info().rss
            text = log.read_bytes()[logged:]
            attack.cancel()
            for one in held:
                one.writer.transport.abort()
        finally:
            process.terminate()
            await process.wait()
    times = [took for status, took in answers if status == 200]
    return {
        "kind": kind,
        "connections": connections,
        "asked": len(answers),
        "answered": len(times),
        "median_ms": round(1e3 * float(np.median(times)), 1) if times else -1.0,
        "worst_ms": round(1e3 * max(times), 1) if times else -1.0,
        "answered_in_last_third": sum(status == 200 for status, _ in answers[-len(answers) // 3 :]),
        "held_at_end": open_still,
        "log_lines": text.count(b"\n"),
        "tracebacks": text.count(b"Traceback"),
        "log_MB": round(len(text) / 1e6, 2),
        "memory_MB": round((after - memory) / 1e6, 1),
    }


async def _start(folder: Path, log: Path) -> tuple[asyncio.subprocess.Process, int, int]:
    """An orchestrator whose other services are not there; its REST and gRPC ports."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith("PRETOUCH_")}
    own = {"DETECTOR": "127.0.0.1:1", "REGISTRAR": "127.0.0.1:1", "STATE": str(folder / "state"), "REST_PORT": "0"}
    variables = {f"PRETOUCH_ORCHESTRATOR_{key}": value for key, value in own.items()}
    with log.open("wb") as stream:
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "pretouch", "serve", "orchestrator", "--port", "0"),
            env=kept | variables,
            stderr=stream,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (OPEN_FILES, OPEN_FILES)),
        )
    async with asyncio.timeout(_READY_WITHIN):
        while True:
            text = await asyncio.to_thread(log.read_text)
            lines = [json.loads(line) for line in text.splitlines() if line.startswith("{")]
            ports = {line["event"]: line["port"] for line in lines if "port" in line}
            if "ready" in ports:
                return process, ports["REST"], ports["ready"]
            if process.returncode is not None:
                raise RuntimeError(text)
            await asyncio.sleep(0.1)


async def _attack(port: int, kind: str, connections: int, held: list[Held]) -> None:
    """Holds `connections` connections, opening one anew where the service closed it."""
    while True:
        held[:] = [one for one in held if not one.reader.at_eof() and not one.writer.is_closing()]
        while len(held) < connections:
            try:
                async with asyncio.timeout(_PATIENCE):
                    held.append(Held(*await asyncio.open_connection("127.0.0.1", port, limit=1)))
            except (OSError, TimeoutError):
                break
            held[-1].writer.write(KINDS[kind])
        await asyncio.sleep(1.0)
        if kind in ("drip", "unread"):  # who does not read finds out by writing that nobody listens
            for one in held:
                with suppress(OSError):
                    one.writer.write(b"x")


async def _ask(url: str, seconds: float) -> list[tuple[int, float]]:
    """Status (0 for none) and seconds of each answer to a good client."""
    answers = []
    end = time.perf_counter() + seconds
    while (began := time.perf_counter()) < end:
        status = 0
        with suppress(httpx.HTTPError):
            async with httpx.AsyncClient(trust_env=False, timeout=_PATIENCE) as client:
                status = (await client.get(url)).status_code
        answers.append((status, time.perf_counter() - began))
        await asyncio.sleep(_ASK_EVERY)
    return answers


if __name__ == "__main__":
    main()
