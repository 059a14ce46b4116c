"""A session of the real services: seen live, recorded, and registered again to the bit; what the viewers are sent."""

from __future__ import annotations

import asyncio
import json
import re
import socket
import struct
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from helpers import box_session
from helpers.rest_sessions import opened, scanned
from helpers.running_up import READY_WITHIN, Up, eventually
from helpers.session_recordings import read_messages

from pretouch.client import AsyncRestClient, RestClient
from pretouch.errors import InvalidInput, Unavailable
from pretouch.live.feed import Feed
from pretouch.serving import Settings
from pretouch.serving.live_view import LiveView
from pretouch.session import Proposer, State


def pretouch(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "pretouch", *arguments],
        capture_output=True,
        text=True,
        timeout=READY_WITHIN,
        check=False,
    )


async def test_the_feed_tells_each_message_once_and_starts_anew_with_a_session(
    rest: Any, orchestrator: Any, tmp_path: Path
) -> None:
    async with AsyncRestClient(orchestrator.rest_url) as client:
        feed = Feed(client, tmp_path)
        session = opened(rest)
        first = await feed.poll()
        assert first is not None
        assert first.session_id == session["id"]
        assert first.new == first.whole
        assert await feed.poll() is None
        await asyncio.to_thread(scanned, rest, session)
        second = await feed.poll()
        assert second is not None
        assert "/pretouch/scans" in {message.topic for message in second.new}
        assert "/camera/depth" not in {message.topic for message in second.new}
        other = opened(rest)
        third = await feed.poll()
        assert third is not None
        assert (third.session_id, third.new) == (other["id"], third.whole)
        rest.delete(f"/v1/sessions/{other['id']}", params={"purge": "true"})


async def test_foxglove_gets_a_session_from_its_start_however_late_it_connects(
    rest: Any, orchestrator: Any, tmp_path: Path
) -> None:
    pytest.importorskip("foxglove", reason="pip install 'pretouch[live]'")
    websockets = pytest.importorskip("websockets.asyncio.client", reason="pip install websockets")
    from pretouch.live.foxglove_server import FoxgloveServer

    session = scanned(rest, opened(rest))
    async with AsyncRestClient(orchestrator.rest_url) as client:
        feed = Feed(client, tmp_path)
        with FoxgloveServer("127.0.0.1", 0) as server:
            server.show(await feed.poll())
            async with websockets.connect(server.url, subprotocols=["foxglove.sdk.v1"], max_size=None) as viewer:
                channels = await _read_channels(viewer)
                assert {"/object/after", "/scan/hits", "/pretouch/session"} <= set(channels)
                wanted = channels["/pretouch/session"]
                subscription = {"op": "subscribe", "subscriptions": [{"id": 1, "channelId": wanted["id"]}]}
                await viewer.send(json.dumps(subscription))
                data = await _next_message(viewer, server)
        assert session["id"].encode() in data
        assert wanted["schemaName"] == "pretouch.v1.RecordedSession"


async def _read_channels(viewer: Any) -> dict[str, Any]:
    channels: dict[str, Any] = {}
    async with asyncio.timeout(60):
        while "/pretouch/session" not in channels:
            message = await viewer.recv()
            if isinstance(message, str) and (document := json.loads(message))["op"] == "advertise":
                channels |= {channel["topic"]: channel for channel in document["channels"]}
    return channels


async def _next_message(viewer: Any, server: Any) -> bytes:
    """The serialised message that comes once the server has noticed the subscription."""
    async with asyncio.timeout(60):
        while True:
            server.show(None)
            try:
                async with asyncio.timeout(0.2):
                    message = await viewer.recv()
            except TimeoutError:
                continue
            if isinstance(message, bytes) and message[0] == 1:
                number, _time = struct.unpack_from("<IQ", message, 1)
                assert number == 1
                return message[13:]


async def test_rerun_serves_on_the_loopback_interface_alone_and_leaves_nothing_behind(
    rest: Any, orchestrator: Any, tmp_path: Path
) -> None:
    pytest.importorskip("rerun", reason="pip install 'pretouch[live]'")
    from pretouch.live.rerun_server import RerunServer

    opened(rest)
    ports = free_ports(2)
    async with AsyncRestClient(orchestrator.rest_url) as client:
        feed = Feed(client, tmp_path)
        async with RerunServer(*ports) as server:
            await asyncio.to_thread(server.show, await feed.poll())
            assert {host for host, port in listening() if port in ports} == {"127.0.0.1"}
    await asyncio.to_thread(eventually, lambda: not any(port in ports for _, port in listening()))


def free_ports(count: int) -> list[int]:
    with ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [int(each.getsockname()[1]) for each in sockets]


def listening() -> set[tuple[str, int]]:
    """Addresses and ports on which somebody listens, from the kernel."""
    found = set()
    for name in ("tcp", "tcp6"):
        for line in Path("/proc/net", name).read_text().splitlines()[1:]:
            fields = line.split()
            address, _, port = fields[1].partition(":")
            if fields[3] == "0A":
                host = socket.inet_ntoa(bytes.fromhex(address)[::-1]) if name == "tcp" else address
                found.add((host, int(port, 16)))
    return found


def test_what_the_live_view_cannot_do_is_said_before_anything_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("foxglove", reason="pip install 'pretouch[live]'")
    LiveView(8765).check(Settings(token="t"))
    with pytest.raises(InvalidInput, match="whose sessions"):
        LiveView(8765).check(Settings(tokens_file=Path("tokens.toml")))
    with pytest.raises(InvalidInput, match="certificate"):
        LiveView(8765).check(Settings(tls_cert=Path("a.pem"), tls_key=Path("a.key")))
    monkeypatch.setattr("pretouch.serving.live_view.find_spec", lambda name: None)
    with pytest.raises(Unavailable) as missing:
        LiveView(rerun=True).check(Settings())
    assert "pretouch[live]" in str(missing.value.remedy)


def test_a_session_of_the_real_services_is_seen_recorded_and_replayed_to_the_bit(tmp_path: Path) -> None:
    pytest.importorskip("foxglove", reason="pip install 'pretouch[live]'")
    ports = ("--rest-port", "0", "--grpc-port", "0", "--gateway-port", "0")
    with Up.running(
        tmp_path, "-m", "pretouch", "up", *ports, "--state", str(tmp_path), "--foxglove", "--foxglove-port", "0"
    ) as up:
        url, _ = up.ready()
        eventually(lambda: bool(re.search(r"connection to ws://127\.0\.0\.1:\d+", up.log.read_text())))
        with RestClient(url, timeout=READY_WITHIN) as client:
            asked = box_session.request(proposer=Proposer.RANDOM)
            session = client.create_session(asked, box_session.DEPTH, box_session.MASK)
            while session.next_scan is not None and len(session.scans) < 2:
                plan = session.next_scan
                session = client.submit(session.id, plan.scan_id, box_session.measured(plan))
            assert session.state is not State.FAILED
        file = tmp_path / "session.mcap"
        assert pretouch("session", "recording", session.id, "-o", str(file), "--url", url).returncode == 0
    done = pretouch("session", "replay", str(file), "--json", "-")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["identical"] is True
    assert document["settings"]["engine"] == "posterior"
    assert [scan["replayed"]["expected_error"] for scan in document["scans"]] == [
        scan.expected_error for scan in session.scans
    ]
    (told,) = read_messages(file.read_bytes())["/pretouch/session"]
    assert told.session.estimate.engine == "posterior"
