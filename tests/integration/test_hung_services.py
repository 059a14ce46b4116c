"""A service that hangs is restarted, by `pretouch up` and by `pretouch serve --watched`; a busy one is left alone."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import httpx
import pytest
from google.protobuf.wrappers_pb2 import StringValue
from helpers.rest_sessions import opened, scanned
from helpers.running_up import TIMEOUT, Up, alive, answers, children_of, eventually
from helpers.serving_probe import Stub

from pretouch.channel import open_channel
from pretouch.serving.child import Child
from pretouch.serving.probing import Probing

pytestmark = pytest.mark.timeout(600)
TESTS = Path(__file__).parents[1]


def test_up_brings_back_stopped_services_and_their_sessions_go_on(tmp_path: Path) -> None:
    with Up.running(tmp_path, "-m", "helpers.impatient_up", str(tmp_path / "state")) as up:
        rest, _ = up.ready()
        with httpx.Client(base_url=rest, timeout=TIMEOUT) as client:
            session = scanned(client, opened(client))
            before = up.children()
            for service in ("registrar", "orchestrator"):
                os.kill(before[service], signal.SIGSTOP)
            eventually(lambda: all(not alive(before[service]) for service in ("registrar", "orchestrator")))
            eventually(lambda: answers(f"{rest}/readyz") == 200)
            assert client.get(f"/v1/sessions/{session['id']}").json() == session
            after = scanned(client, session)
            assert after["budget_used"]["scans"] == 2
        reasons = {line["child"]: line["reason"] for line in up.warnings()}
        assert reasons["registrar"] == reasons["orchestrator"] == "left 2 health checks in a row unanswered"
        up.process.send_signal(signal.SIGTERM)
        assert up.process.wait(TIMEOUT) == 0


async def test_a_blocked_event_loop_is_restarted_and_a_busy_one_is_not() -> None:
    ready: asyncio.Queue[dict[str, Any]] = asyncio.Queue()

    def note(_: bytes, fields: dict[str, Any]) -> None:
        if fields.get("event") == "ready":
            ready.put_nowait(fields)

    environment = os.environ | {"PYTHONPATH": os.pathsep.join((str(TESTS), os.environ.get("PYTHONPATH", "")))}
    child = Child(
        "probe",
        (sys.executable, "-m", "helpers.serving_probe", "1"),
        0,
        environment,
        note,
        probing=Probing(every=0.01, timeout=2.0, misses=2),
    )
    try:
        port = await child.wait_until_ready()
        async with open_channel(f"127.0.0.1:{port}") as channel:
            stub = Stub(channel)
            await stub.unary(StringValue(value="spin:5"), timeout=TIMEOUT)
            assert ready.qsize() == 1, "work in a thread takes nothing from the health checks"
            held = asyncio.ensure_future(stub.unary(StringValue(value="block"), timeout=TIMEOUT))
            async with asyncio.timeout(TIMEOUT):
                assert (await ready.get())["port"] == (await ready.get())["port"] == port
            await asyncio.wait([held])
            assert held.exception() is not None
            answer = await stub.unary(StringValue(value="again"), timeout=TIMEOUT, wait_for_ready=True)
            assert answer.value == "again"
    finally:
        await child.stop()


def test_a_watched_service_comes_back_on_its_port_and_ends_with_its_watcher(tmp_path: Path) -> None:
    log = tmp_path / "log"
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PRETOUCH_")}
    options = ("--watched", "--port", "0", "--token", "s3cret", "--alive-file", str(tmp_path / "alive"))
    with log.open("w") as written:
        watcher = subprocess.Popen(
            [sys.executable, "-m", "pretouch", "serve", "gateway", *options],
            stderr=written,
            stdin=subprocess.DEVNULL,
            env=environment,
        )

    def ports() -> list[int]:
        lines = [json.loads(line) for line in log.read_text().splitlines()]
        return [line["port"] for line in lines if line["event"] == "ready"]

    with watcher:
        try:
            eventually(lambda: len(ports()) == 1)
            eventually((tmp_path / "alive").exists)
            first = children_of(watcher.pid)["gateway"]
            assert "s3cret" not in Path(f"/proc/{first}/cmdline").read_text()
            os.kill(first, signal.SIGKILL)
            eventually(lambda: len(ports()) == 2)
            assert ports()[0] == ports()[1]
            second = children_of(watcher.pid)["gateway"]
            watcher.send_signal(signal.SIGTERM)
            assert watcher.wait(TIMEOUT) == 0
            assert not alive(second)
            assert "a service is restarted" in log.read_text()
        finally:
            if watcher.poll() is None:
                watcher.kill()


def test_a_watched_service_that_cannot_start_ends_with_a_reason() -> None:
    environment = os.environ | {"PRETOUCH_GATEWAY_DEVICES": "finger=nonsense://here"}
    command = [sys.executable, "-m", "pretouch", "serve", "gateway", "--watched", "--port", "0"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT, env=environment, check=False)
    assert ended.returncode == 1
    assert "nonsense" in ended.stderr
    assert "Traceback" not in ended.stderr
