"""Devices over REST: their state, tip poses as they come, and ranges as events."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from helpers.box_session import TOKEN
from helpers.fake_upstream import NOW, FakeUpstream
from helpers.problems import TIMEOUT, check, over_rest
from helpers.processes import Orchestrator

from pretouch.errors import (
    Forbidden,
    InvalidInput,
    Malformed,
    NotFound,
    PretouchError,
    Unauthenticated,
    Unavailable,
    UnsupportedMedia,
)
from pretouch.serving.tokens import make_token

LINES = {"Content-Type": "application/x-ndjson"}
POSE = {"translation": [0.4, 0.0, 0.05], "rotation": [1.0, 0.0, 0.0, 0.0]}


def line(t: object, **members: Any) -> bytes:
    return json.dumps({"t": t, "base_T_tip": POSE} | members).encode() + b"\n"


def get(orchestrator: Orchestrator, path: str, **options: Any) -> httpx.Response:
    return httpx.get(orchestrator.rest_url + path, timeout=TIMEOUT, trust_env=False, **options)


def send(orchestrator: Orchestrator, body: Any, query: str = "", **options: Any) -> httpx.Response:
    url = f"{orchestrator.rest_url}/v1/devices/finger/poses{query}"
    return httpx.post(url, content=body, timeout=TIMEOUT, trust_env=False, **{"headers": LINES} | options)


def test_devices_and_what_is_known_of_each(orchestrator: Orchestrator) -> None:
    (device,) = get(orchestrator, "/v1/devices").json()["devices"]
    assert device == {
        "name": "finger",
        "port": "/dev/ttyACM0",
        "state": "streaming",
        "problem": None,
        "measurements": 7,
        "refused": 0,
        "lost": 0,
    }
    status = get(orchestrator, "/v1/devices/finger").json()
    assert status.items() >= (device | {"format": "binary", "rate": 30.0, "now": NOW}).items()
    assert status["modules"] == [{"range": None, "range_status": "no_target", "status": 7}]


def test_ranges_come_as_events(orchestrator: Orchestrator) -> None:
    answer = get(orchestrator, "/v1/devices/finger/ranges")
    assert answer.headers["content-type"].startswith("text/event-stream")
    events = [dict(part.split(": ", 1) for part in event.splitlines()) for event in answer.text.strip().split("\n\n")]
    assert [event["event"] for event in events] == ["ranges"] * 3
    data = json.loads(events[1]["data"])
    assert data["t"] == [NOW + 1, NOW + 1.5]
    assert (data["range"], data["range_status"]) == ([[0.03], [None]], [["good"], ["no_target"]])
    assert (data["status"], data["flags"], data["sequence"]) == ([[0], [7]], [[1], [0]], [2, 3])


def test_a_stream_of_ranges_that_breaks_says_why(orchestrator: Orchestrator, fakes: FakeUpstream) -> None:
    fakes.fail("StreamRanges", Unavailable("The gateway is shutting down.", "Connect again."))
    event, data = get(orchestrator, "/v1/devices/finger/ranges").text.strip().splitlines()
    assert event == "event: error"
    assert json.loads(data.removeprefix("data: "))["detail"] == "The gateway is shutting down."


def test_poses_are_passed_on_while_they_come(orchestrator: Orchestrator, fakes: FakeUpstream) -> None:
    calls = fakes.count("StreamPoints")

    def body() -> Iterator[bytes]:
        """Cut anywhere; the last poses are sent when the gateway has heard of the first."""
        first = line(NOW) + line(NOW + 0.1)
        yield first[:50]
        yield first[50:] + b"\n"
        for _ in range(2):
            fakes.wait_for_call("TipPose")
        yield line(NOW + 0.2) + line(NOW + 0.3)[:-1]  # no line end after the last

    answer = send(orchestrator, body(), "?clock_offset=-12.5")
    assert answer.status_code == 200, answer.text
    assert answer.json() == {"poses": 4, "out_of_order": 1, "samples": 4, "unposed": 2}
    assert fakes.poses == pytest.approx([NOW, NOW + 0.1, NOW + 0.2, NOW + 0.3])
    assert fakes.count("StreamPoints") == calls + 1
    (first,) = [call.request for call in fakes.calls if call.method == "StreamPoints"][-1:]
    assert (first.device, first.clock_offset) == ("finger", -12.5)


@pytest.mark.parametrize(
    ("body", "kind", "said"),
    [
        (line(1.0) + b"{]\n", Malformed, "Line 2 is not JSON"),
        (line(1.0) + b"\n" + b'{"t": 1.0}\n', InvalidInput, "Line 3: base_T_tip is missing"),
        (line(1.0, speed=3), InvalidInput, "Line 1: speed is not a known member"),
        (line("now"), InvalidInput, "Line 1: t is a string"),
        (line(None)[:-1], InvalidInput, "Line 1: t is null"),
        (b'{"t": NaN}\n', Malformed, "Line 1"),
        (b" " * 5000, Malformed, "Line 1 does not end"),
        (line(1.0, base_T_tip={"translation": [0, 0, 0], "rotation": [0, 0, 0, 2]}), InvalidInput, "Line 1"),
        (line(0.0), InvalidInput, "0.000 s"),
    ],
)
def test_what_is_no_pose_is_refused_with_its_line(
    body: bytes, kind: type[PretouchError], said: str, orchestrator: Orchestrator
) -> None:
    def chunks() -> Iterator[bytes]:
        yield body
        if kind is not Malformed or b"t" in body:
            yield b""

    document, _ = over_rest(orchestrator, "POST", "/v1/devices/finger/poses", content=chunks(), headers=LINES)
    check(document, kind, said)


def test_what_cannot_be_asked(orchestrator: Orchestrator) -> None:
    for method, path, kind in (
        ("GET", "/v1/devices/thumb", NotFound),
        ("GET", "/v1/devices/thumb/ranges", NotFound),
        ("POST", "/v1/devices/thumb/poses", NotFound),
        ("POST", "/v1/devices/finger/poses?clock_offset=nan", InvalidInput),
        ("POST", "/v1/devices/finger/poses?clock_offset=soon", InvalidInput),
    ):
        options = {"content": line(1.0), "headers": LINES} if method == "POST" else {}
        check(over_rest(orchestrator, method, path, **options)[0], kind)
    document, _ = over_rest(orchestrator, "POST", "/v1/devices/finger/poses", json={"t": 1.0})
    check(document, UnsupportedMedia, "application/json")


def test_without_a_gateway_devices_are_unavailable(fakes: FakeUpstream, tmp_path: Path) -> None:
    with Orchestrator(tmp_path, fakes.address, gateway=False) as orchestrator:
        for path in ("/v1/devices", "/v1/devices/finger", "/v1/devices/finger/ranges"):
            document, _ = over_rest(orchestrator, "GET", path)
            check(document, Unavailable, "no sensor gateway")
            assert "PRETOUCH_ORCHESTRATOR_GATEWAY" in document["remedy"]


def test_tokens_are_asked_for_and_one_for_reading_moves_no_finger(fakes: FakeUpstream, tmp_path: Path) -> None:
    tokens = tmp_path / "tokens.toml"
    token, entry = make_token("line-1", "read")
    tokens.write_text(entry)
    tokens.chmod(0o600)
    variables: Any = {"PRETOUCH_TOKENS_FILE": str(tokens), "PRETOUCH_TOKEN": TOKEN}
    with Orchestrator(tmp_path / "state", fakes.address, **variables) as guarded:
        check(over_rest(guarded, "GET", "/v1/devices")[0], Unauthenticated)
        reader, full = ({"Authorization": f"Bearer {each}"} for each in (token, TOKEN))
        for path in ("/v1/devices", "/v1/devices/finger", "/v1/devices/finger/ranges"):
            assert get(guarded, path, headers=reader).status_code == 200
        path = "/v1/devices/finger/poses"
        check(over_rest(guarded, "POST", path, content=line(1.0), headers=LINES)[0], Unauthenticated)
        check(over_rest(guarded, "POST", path, content=line(1.0), headers=LINES | reader)[0], Forbidden)
        assert send(guarded, line(1.0), headers=LINES | full).status_code == 200
