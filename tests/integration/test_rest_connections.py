"""Connections that keep REST waiting, or speak no HTTP, over real sockets: what they get, and what others notice."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import httpx
import pytest
import structlog
from fastapi import FastAPI
from fastapi.responses import PlainTextResponse, StreamingResponse
from helpers.processes import free_port
from pretouch_orchestrator.rest import connection, server
from pretouch_orchestrator.rest.body_limit import BodyLimit
from pretouch_orchestrator.rest.problems import answer_errors_as_problems
from pretouch_orchestrator.settings import OrchestratorSettings
from starlette.requests import Request

from pretouch.serving import ServiceContext, Settings

PATIENCE, LEAST_BYTES = 0.4, 100_000
TIMEOUT = 20
LARGE = 30_000_000
HEAD = b"GET /large HTTP/1.1\r\nHost: a\r\n\r\n"


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "PATIENCE", PATIENCE)
    monkeypatch.setattr(connection, "LEAST_BYTES", LEAST_BYTES)
    monkeypatch.setattr(server, "_CHECK_EVERY", 1)


@asynccontextmanager
async def served(limit: int = 100) -> AsyncIterator[int]:
    """The port of a small application behind the server of REST."""
    app = FastAPI()
    app.add_middleware(BodyLimit)

    @app.get("/large")
    async def large() -> PlainTextResponse:
        return PlainTextResponse("x" * LARGE)

    @app.get("/endless")
    async def endless() -> StreamingResponse:
        return StreamingResponse(chunks())

    async def chunks() -> AsyncIterator[bytes]:
        while True:
            yield bytes(100_000)
            await asyncio.sleep(0)

    @app.get("/quiet")
    async def quiet() -> StreamingResponse:
        return StreamingResponse(beats())

    async def beats() -> AsyncIterator[bytes]:
        for _ in range(3):
            yield b"beat\n"
            await asyncio.sleep(PATIENCE)

    @app.post("/body")
    async def body(request: Request) -> int:
        return len(await request.body())

    @app.post("/poses")
    async def poses(request: Request) -> int:
        request.scope[connection.SLOW_BODY] = True
        return len(await request.body())

    @app.post("/unread")
    async def refuse() -> int:
        return 0

    context = ServiceContext("orchestrator", Settings())
    answer_errors_as_problems(app, context)
    settings = OrchestratorSettings("a:1", "b:1", "sqlite:/nowhere", rest_port=free_port())
    async with server.serve_rest(app, settings, context, limit):
        yield settings.rest_port


async def say(port: int, *pieces: bytes, every: float = 0.0) -> bytes:
    """What is answered to the pieces until the service closes the connection."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    answer = asyncio.create_task(reader.read())
    async with asyncio.timeout(TIMEOUT):
        for piece in pieces:
            if answer.done():
                break
            writer.write(piece)
            await asyncio.sleep(every)
        try:
            return await answer
        except ConnectionError:
            return b""
        finally:
            writer.close()


def problem_in(answer: bytes) -> dict[str, Any]:
    """The problem document of an answer's last response."""
    head, _, body = answer.rpartition(b"\r\n\r\n")
    assert b"application/problem+json" in head, answer
    assert b"connection: close" in head.lower(), answer
    return dict(json.loads(body))


@pytest.mark.parametrize(
    ("pieces", "said"),
    [
        ([b"GET /large HTTP/1.1\r\nHo", *[b"x"] * 50], "head"),
        ([b"POST /body HTTP/1.1\r\nHost: a\r\nContent-Length: 900000\r\n\r\n", *[b"x"] * 50], "body"),
        ([b"POST /body HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked\r\n\r\n", *[b"1\r\nx\r\n"] * 50], "body"),
    ],
)
async def test_what_drips_is_ended_with_a_reason(pieces: list[bytes], said: str) -> None:
    async with served() as port:
        problem = problem_in(await say(port, *pieces, every=0.05))
    assert problem["status"] == 400
    assert said in problem["detail"]


async def test_who_sends_nothing_or_reads_nothing_is_let_go() -> None:
    async with served() as port:
        assert await say(port) == b""
        assert b"200 OK" in await say(port, b"POST /unread HTTP/1.1\r\nHost: a\r\nContent-Length: 900000\r\n\r\n")
        for path in (b"/large", b"/endless"):
            with socket.create_connection(("127.0.0.1", port)) as lazy:
                lazy.setblocking(False)
                lazy.send(b"GET " + path + b" HTTP/1.1\r\nHost: a\r\n\r\n")
                await until_closed(lazy)


async def until_closed(lazy: socket.socket) -> None:
    """Returns once the other end has aborted the connection; nothing of it is read."""
    for _ in range(100 * TIMEOUT):
        if lazy.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            return
        await asyncio.sleep(0.01)
    raise AssertionError("it is still open")


async def test_who_is_slow_but_comes_on_is_served() -> None:
    async with served() as port:
        head = b"POST /body HTTP/1.1\r\nHost: a\r\nConnection: close\r\nContent-Length: 1000000\r\n\r\n"
        assert (await say(port, head, *[bytes(25_000)] * 40, every=0.05)).endswith(b"1000000")
        async with httpx.AsyncClient(trust_env=False, timeout=TIMEOUT) as client:
            async with client.stream("GET", f"http://127.0.0.1:{port}/large") as answer:
                read = 0
                async for chunk in answer.aiter_bytes(2_000_000):
                    read += len(chunk)
                    await asyncio.sleep(0.1)
            assert read == LARGE
            assert (await client.get(f"http://127.0.0.1:{port}/quiet")).text == "beat\n" * 3


async def test_a_body_that_comes_as_a_robot_moves_may_be_slow_but_not_stand_still() -> None:
    head = b"POST /poses HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked\r\n\r\n"
    async with served() as port, asyncio.timeout(TIMEOUT):
        slow = await say(port, head, *[b"1\r\n.\r\n"] * 12, b"0\r\n\r\n", every=PATIENCE / 4)
        assert slow.startswith(b"HTTP/1.1 200")
        assert slow.endswith(b"12")
        still = await say(port, head, b"1\r\n.\r\n")
        assert "poses did not come in time" in problem_in(still)["detail"]


async def test_of_requests_that_do_not_wait_for_an_answer_one_is_served() -> None:
    request = b"POST /unread HTTP/1.1\r\nHost: a\r\nContent-Length: 0\r\n\r\n"
    async with served() as port:
        assert (await say(port, request * 100)).count(b"200 OK") == 1


@pytest.mark.parametrize(
    ("request_bytes", "status"),
    [
        (b"GET /\r\n\r\n", 400),
        (b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", 400),
        (b"\x16\x03\x01\x00\xa5\x01\x00\x00\xa1\x03\x03\r\n\r\n", 400),
        (b"GET /large HTTP/1.1\r\n\r\n", 400),
        (b"GET /large HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n", 400),
        (b"GET /\xff HTTP/1.1\r\nHost: a\r\n\r\n", 400),
        (b"GET /large HTTP/1.1\r\nHost: a\r\nX-Long: " + b"x" * 100_000 + b"\r\n\r\n", 413),
        (b"POST /body HTTP/1.1\r\nHost: a\r\nContent-Length: 3\r\nContent-Length: 4\r\n\r\nabcd", 400),
        (b"POST /body HTTP/1.1\r\nHost: a\r\nContent-Length: three\r\n\r\nabc", 400),
        (b"POST /body HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: gzip\r\n\r\nabc", 400),
        (b"POST /body HTTP/1.1\r\nHost: a\r\nContent-Length: 3\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n", 400),
        (b"POST /body HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\nabc", 400),
    ],
)
async def test_what_is_no_http_is_answered_as_a_problem(request_bytes: bytes, status: int) -> None:
    with structlog.testing.capture_logs():
        async with served() as port:
            problem = problem_in(await say(port, request_bytes))
    assert problem["status"] == status
    assert problem["remedy"]


async def test_the_newest_client_is_served_while_others_hold_every_connection(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(connection, "PATIENCE", TIMEOUT)
    limit = 10
    async with AsyncExitStack() as stack:
        port = await stack.enter_async_context(served(limit))
        held = [await asyncio.open_connection("127.0.0.1", port) for _ in range(limit)]
        for _, writer in held:
            stack.callback(writer.close)
            writer.write(b"GET /la")
        client = await stack.enter_async_context(httpx.AsyncClient(trust_env=False, timeout=TIMEOUT))
        assert (await client.post(f"http://127.0.0.1:{port}/body", content=b"abc")).text == "3"
        async with asyncio.timeout(TIMEOUT):
            with pytest.raises(ConnectionError):  # the oldest made room
                assert await held[0][0].read() == b"nothing"


async def test_connections_that_are_all_busy_are_not_closed_for_another() -> None:
    async with (
        served(1) as port,
        httpx.AsyncClient(trust_env=False, timeout=TIMEOUT) as client,
        client.stream("GET", f"http://127.0.0.1:{port}/quiet") as answer,
    ):
        with pytest.raises(httpx.TransportError):
            await client.get(f"http://127.0.0.1:{port}/large")
        assert (await answer.aread()) == b"beat\n" * 3
