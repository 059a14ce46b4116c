"""Whatever a server answers, or a program gives, a client raises errors of pretouch and no others, and in time."""

from __future__ import annotations

import asyncio
import json
import math
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import pytest
from helpers.client_kinds import KINDS, opened
from helpers.hostile_server import GrpcFault, HostileGrpc, HostileHttp, HttpFault
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_client_calls import DEPTH, REQUEST, SESSION

from pretouch.client import AsyncGrpcClient, AsyncRestClient, GrpcClient, RestClient
from pretouch.errors import Conflict, DeadlineExceeded, InvalidInput, PretouchError, TooLarge
from pretouch.session import SampleChunk, Skipped
from pretouch.tof import RangeSamples
from pretouch.v1 import orchestrator_pb2 as pb
from pretouch.wire.json import session_to_json
from pretouch.wire.session import session_to_proto

every_client = pytest.mark.parametrize("kind", KINDS)
rest_clients = pytest.mark.parametrize("kind", ["rest", "rest-async"])
NOTHING = SampleChunk(0, RangeSamples.concatenate([]))
CALLS: dict[str, Callable[[Any], Any]] = {
    "create_session": lambda client: client.create_session(REQUEST, DEPTH),
    "session": lambda client: client.session("s1"),
    "sessions": lambda client: client.sessions(),
    "next_scan": lambda client: client.next_scan("s1"),
    "submit": lambda client: client.submit("s1", "scan-1", Skipped()),
    "tell": lambda client: client.tell("s1", "scan-1", NOTHING),
    "cancel": lambda client: client.cancel("s1"),
    "events": lambda client: listen(client),
}
LEAVES = st.sampled_from([None, "x", "", "\ud800", True, -1, 10**400, 1e308, [], {}, [[]]])


async def listen(client: Any, after: Any = 0) -> list[Any]:
    return [event async for event in client.events("s1", after)]


@pytest.fixture(scope="module")
def http() -> Iterator[HostileHttp]:
    with HostileHttp() as server:
        yield server


@pytest.fixture(scope="module")
def rpc() -> Iterator[HostileGrpc]:
    with HostileGrpc() as server:
        yield server


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pretouch.client.retries._FIRST_DELAY", 1e-3)
    monkeypatch.setattr("pretouch.client.retries._MAX_DELAY", 2e-3)


def answer(status: bytes, headers: dict[bytes, bytes], body: bytes) -> bytes:
    lines = [b"HTTP/1.1 " + status, *(name + b": " + value for name, value in headers.items())]
    return b"\r\n".join(lines) + b"\r\n\r\n" + body


@st.composite
def sessions_with_a_fault(draw: st.DrawFn) -> bytes:
    """A session's JSON in which one member, at any depth, is another value."""
    document = session_to_json(SESSION)
    place: Any = document
    while True:
        key = draw(st.sampled_from(sorted(place) if isinstance(place, dict) else range(len(place))))
        if not place[key] or not isinstance(place[key], dict | list) or draw(st.booleans()):
            place[key] = draw(LEAVES)
            return json.dumps(document).encode()
        place = place[key]


PROBLEMS = st.fixed_dictionaries(
    {"type": st.sampled_from(["urn:pretouch:problem:overloaded", "urn:pretouch:problem:unavailable", 5, None])},
    optional={"detail": LEAVES, "remedy": LEAVES, "retry_after": LEAVES | st.just(0) | st.just(math.nan)},
).map(lambda document: json.dumps(document).encode())
BODIES = st.one_of(
    sessions_with_a_fault(),
    PROBLEMS,
    st.sampled_from([b"", b"{}", b"[]", b"null", b"1e999", b"[" * 10**5, b"9" * 5000, b'{"sessions":[],"next":1}']),
    st.binary(max_size=40),
    st.binary(max_size=40).map(lambda data: b"id: 1\nevent: end\ndata: " + data + b"\n\n"),
)
STATUSES = [
    b"200 OK",
    b"201",
    b"204 X",
    b"100 X",
    b"101 X",
    b"301 X",
    b"404 X",
    b"429 X",
    b"500 X",
    b"503 X",
    b"504 X",
    b"999",
]
HEADERS = st.fixed_dictionaries(
    {},
    optional={
        b"Content-Type": st.sampled_from(
            [b"application/json", b"application/problem+json", b"text/event-stream", b"\xff"]
        ),
        b"Content-Length": st.sampled_from([b"0", b"3", b"99999999999", b"-1", b"x"]),
        b"Content-Encoding": st.sampled_from([b"gzip", b"deflate", b"br", b"x"]),
        b"Transfer-Encoding": st.sampled_from([b"chunked", b"gzip, chunked"]),
        b"Retry-After": st.sampled_from([b"0", b"-1", b"999", b"soon", b"Wed, 21 Oct 2015 07:28:00 GMT"]),
        b"Location": st.just(b"http://[::1"),
        b"X": st.sampled_from([b"\0", b"a" * 200_000]),
    },
)
HTTP_FAULTS = st.builds(
    HttpFault,
    st.builds(answer, st.sampled_from(STATUSES), HEADERS, BODIES) | st.binary(max_size=40),
    st.sampled_from(["close", "close", "close", "reset", "wait", "drip"]),
)
MESSAGES = st.binary(max_size=30) | st.sampled_from(
    [
        pb.GetSessionResponse(session=session_to_proto(SESSION)).SerializeToString(),
        pb.StreamEventsResponse(id=1, type="end", data="{").SerializeToString(),
    ]
)
GRPC_FAULTS = st.builds(
    GrpcFault,
    st.lists(MESSAGES, max_size=2).map(tuple),
    st.sampled_from(list(grpc.StatusCode)),
    st.none() | PROBLEMS | st.binary(max_size=20) | st.just(b"[" * 2000),
)
NAMES = st.sampled_from(sorted(CALLS))
explore = settings(
    max_examples=50, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck)
)


async def call(kind: str, address: str, name: str) -> None:
    """The call returns, or raises an error of pretouch."""
    async with opened(kind, f"http://{address}", address, timeout=0.1) as client:
        try:
            await CALLS[name](client)
        except PretouchError as error:
            assert error.detail  # noqa: PT017 -- any of them will do


@pytest.mark.usefixtures("impatient")
@rest_clients
def test_whatever_is_answered_over_http_is_an_error_of_pretouch(kind: str, http: HostileHttp) -> None:
    @explore
    @given(HTTP_FAULTS, NAMES)
    def check(fault: HttpFault, name: str) -> None:
        http.fault = fault
        asyncio.run(call(kind, http.address, name))

    check()


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("kind", ["grpc", "grpc-async"])
def test_whatever_is_answered_over_grpc_is_an_error_of_pretouch(kind: str, rpc: HostileGrpc) -> None:
    @explore
    @given(GRPC_FAULTS, NAMES)
    def check(fault: GrpcFault, name: str) -> None:
        rpc.fault = fault
        asyncio.run(call(kind, rpc.address, name))

    check()


@every_client
@pytest.mark.parametrize(
    "part", [b"HTTP/1.1 200 ", b"HTTP/1.1 200 OK\r\nX: ", b"HTTP/1.1 200 OK\r\nContent-Length: 99999999\r\n\r\n"]
)
@pytest.mark.parametrize("name", [name for name in CALLS if name != "events"])
async def test_the_timeout_is_that_of_the_whole_call(kind: str, part: bytes, name: str, http: HostileHttp) -> None:
    http.fault = HttpFault(part, "drip")
    async with opened(kind, f"http://{http.address}", http.address, timeout=0.15) as client:
        with pytest.raises(PretouchError) as caught:
            await CALLS[name](client)
    assert "grpc" in kind or type(caught.value) is DeadlineExceeded


@rest_clients
async def test_an_event_stream_that_never_opens_ends_in_time(kind: str, http: HostileHttp) -> None:
    http.fault = HttpFault(b"HTTP/1.1 200 OK\r\nX: ", "drip")
    async with opened(kind, f"http://{http.address}", http.address, timeout=0.15) as client:
        with pytest.raises(DeadlineExceeded):
            await listen(client)


@rest_clients
async def test_a_request_that_is_not_read_ends_in_time(kind: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        async with opened(kind, f"http://127.0.0.1:{silent.getsockname()[1]}", "", timeout=0.15) as client:
            with pytest.raises(DeadlineExceeded):
                await client.create_session(
                    REQUEST, np.random.default_rng(0).integers(0, 9999, (1500, 1500), np.uint16)
                )


@rest_clients
async def test_a_name_that_is_never_resolved_ends_in_time(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    answered = threading.Event()
    resolve = socket.getaddrinfo

    def wait(host: Any, *rest: Any, **options: Any) -> Any:
        answered.wait(60)
        return resolve("127.0.0.1", *rest, **options)

    monkeypatch.setattr(socket, "getaddrinfo", wait)
    try:
        async with opened(kind, "http://robot.invalid:1", "", timeout=0.15) as client:
            with pytest.raises(DeadlineExceeded):
                await client.session("s1")
    finally:
        answered.set()


@rest_clients
async def test_an_answer_without_end_is_refused(kind: str, http: HostileHttp) -> None:
    http.fault = HttpFault(answer(b"200 OK", {}, b" " * 40_000_000))
    async with opened(kind, f"http://{http.address}", http.address) as client:
        with pytest.raises(TooLarge):
            await client.session("s1")


@every_client
async def test_a_closed_client_says_so(kind: str, http: HostileHttp, rpc: HostileGrpc) -> None:
    async with opened(kind, f"http://{http.address}", rpc.address) as client:
        await client.close()
        await client.close()
        for call in CALLS.values():
            with pytest.raises(Conflict, match="closed"):
                await call(client)


@every_client
async def test_closing_ends_the_calls_under_way(kind: str, http: HostileHttp) -> None:
    http.fault = HttpFault(b"", "wait")
    async with opened(kind, f"http://{http.address}", http.address, timeout=5.0) as client:
        calling = asyncio.ensure_future(client.session("s1"))
        await asyncio.sleep(0.1)
        await client.close()
        with pytest.raises(PretouchError):
            await calling


@pytest.mark.parametrize("kind", ["rest-async", "grpc-async"])
async def test_a_cancelled_task_stays_cancelled(kind: str, http: HostileHttp) -> None:
    http.fault = HttpFault(b"", "wait")
    async with opened(kind, f"http://{http.address}", http.address) as client:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.1):
                await client.session("s1")


@every_client
@pytest.mark.parametrize(
    "call",
    [
        *(lambda client, wrong=wrong: client.session("s1", timeout=wrong) for wrong in (0, -1, math.nan, math.inf)),
        *(lambda client, wrong=wrong: listen(client, wrong) for wrong in (-1, None, "7", 10**30)),
        *(lambda client, wrong=wrong: client.create_session(REQUEST, wrong) for wrong in (None, b"", "/", "/\0")),
        *(lambda client, key=key: client.create_session(REQUEST, DEPTH, None, key) for key in ("a\nb", "é", " a", 5)),
        lambda client: client.create_session(None, DEPTH),
        lambda client: client.create_session(REQUEST, DEPTH, DEPTH[0]),
        lambda client: client.submit("s1", "scan-1", None),
        lambda client: client.tell("s1", "scan-1", "x"),
        lambda client: client.session(5),
        lambda client: client.sessions("many"),
        lambda client: client.sessions(cursor=b"\xff"),
    ],
)  # fmt: skip
async def test_wrong_arguments_are_errors_of_pretouch(
    kind: str, call: Callable[[Any], Any], http: HostileHttp, rpc: HostileGrpc
) -> None:
    http.fault, rpc.fault = HttpFault(answer(b"400", {}, b"")), GrpcFault(code=grpc.StatusCode.INVALID_ARGUMENT)
    async with opened(kind, f"http://{http.address}", rpc.address) as client:
        with pytest.raises(PretouchError) as caught:
            await call(client)
    assert caught.value.detail


@pytest.mark.parametrize(
    "url",
    [
        "http://h:99999",
        "http://h:0",
        "http://[::1",
        "http://",
        "http://a\0b",
        "http://\ud800",
        "http://a b",
        "",
        5,
        "ftp://h",
    ],
)
@pytest.mark.parametrize("client", [RestClient, AsyncRestClient])
def test_a_url_that_is_none_is_refused(url: Any, client: Any) -> None:
    with pytest.raises(InvalidInput, match="address"):
        client(url)


@pytest.mark.parametrize("token", ["a\nb", "é", "a b"])
@pytest.mark.parametrize("client", [RestClient, AsyncRestClient, GrpcClient, AsyncGrpcClient])
async def test_a_token_that_no_header_carries_is_refused(token: str, client: Any) -> None:
    with pytest.raises(InvalidInput, match="token") as caught:
        client(token=token)
    assert token not in caught.value.detail


@pytest.mark.parametrize("client", [RestClient, AsyncRestClient])
def test_tls_files_are_not_ignored(client: Any, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="not encrypted"):
        client("http://127.0.0.1", tls_ca=tmp_path / "ca.pem")
    with pytest.raises(InvalidInput, match="key"):
        client("https://127.0.0.1", tls_key=tmp_path / "key.pem")


def test_an_asynchronous_grpc_client_wants_a_loop() -> None:
    with pytest.raises(InvalidInput, match="loop"):
        AsyncGrpcClient()
