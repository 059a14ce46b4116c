"""`pretouch.serving` over real sockets: tokens, limits, errors, health, metrics, overload."""

from __future__ import annotations

import asyncio
import inspect
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import grpc
import httpx
import pytest
import structlog
from google.protobuf.wrappers_pb2 import BytesValue, StringValue
from grpc_health.v1 import health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha import reflection_pb2, reflection_pb2_grpc
from helpers.serving_probe import SERVICE, Stub, running

from pretouch import errors
from pretouch.channel import MESSAGE_LIMIT, open_channel, open_sync_channel
from pretouch.serving import ServiceContext, Settings, Started, started

SERVING = health_pb2.HealthCheckResponse.SERVING
NOT_SERVING = health_pb2.HealthCheckResponse.NOT_SERVING
TIMEOUT = 20


@asynccontextmanager
async def probe(token: str | None = None, **settings: Any) -> AsyncIterator[tuple[Stub, Started]]:
    """A running probe and a client with the right token."""
    async with (
        started("probe", running, Settings(token=token, **settings)) as service,
        open_channel(f"127.0.0.1:{service.port}", token) as channel,
    ):
        yield Stub(channel), service


def text(value: str) -> StringValue:
    return StringValue(value=value)


async def eventually(holds: Callable[[], bool | Awaitable[bool]]) -> None:
    """Returns once `holds()`; what it waits for happens in another task or thread that tells nobody."""
    for _ in range(100 * TIMEOUT):
        answer = holds()
        if await answer if inspect.isawaitable(answer) else answer:
            return
        await asyncio.sleep(0.01)
    raise AssertionError("it never came to hold")


def value(service: ServiceContext, metric: str, labels: dict[str, str] | None = None) -> float | None:
    return service.metrics.registry.get_sample_value(f"pretouch_probe_{metric}", labels)


async def failure(call: Any) -> errors.PretouchError:
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await call
    return errors.from_rpc_error(caught.value)


async def test_bytes_that_are_no_message_are_malformed(caplog: pytest.LogCaptureFixture) -> None:
    async with probe() as (_, service), open_channel(f"127.0.0.1:{service.port}") as channel:
        for name, kind in (
            ("unary", "unary_unary"),
            ("gathered", "stream_unary"),
            ("counted", "unary_stream"),
            ("echoed", "stream_stream"),
        ):
            for data in (b"\xff", b"\x0a\x02\xff\xff"):  # not the wire format; a string that is not UTF-8
                method = getattr(channel, kind)(f"/{SERVICE}/{name.capitalize()}")
                call = method(iter([data]) if kind.startswith("stream") else data, timeout=TIMEOUT)
                error = await failure(call if kind.endswith("unary") else call.read())
                assert isinstance(error, errors.Malformed), name
                assert error.remedy
    assert "Traceback" not in caplog.text


async def test_all_kinds_of_call_carry_the_token() -> None:
    async with probe("s3cret") as (stub, _):
        assert (await stub.unary(text("hello"), timeout=TIMEOUT)).value == "hello"
        assert (await stub.gathered(iter([text("a"), text("b")]), timeout=TIMEOUT)).value == "a b"
        stream = stub.counted(text("2"), timeout=TIMEOUT)
        assert [(await stream.read()).value for _ in range(2)] == ["0", "1"]
        echo = stub.echoed(timeout=TIMEOUT)
        for word in ("there", "and back"):
            await echo.write(text(word))
            assert (await echo.read()).value == word
        await echo.done_writing()
        assert await echo.read() is grpc.aio.EOF


async def test_the_synchronous_channel_carries_the_token_too() -> None:
    def talk(port: int) -> list[str]:
        with open_sync_channel(f"127.0.0.1:{port}", "s3cret") as channel:
            stub = Stub(channel)
            return [
                stub.unary(text("one"), timeout=TIMEOUT).value,
                stub.gathered(iter([text("a"), text("b")]), timeout=TIMEOUT).value,
                *(answer.value for answer in stub.echoed(iter([text("c")]), timeout=TIMEOUT)),
                next(stub.counted(text("1"), timeout=TIMEOUT)).value,
            ]

    async with probe("s3cret") as (_, service):
        assert await asyncio.to_thread(talk, service.port) == ["one", "a b", "c", "0"]


@pytest.mark.parametrize("token", ["s3cret?", None])
async def test_a_wrong_or_missing_token_is_refused_in_every_kind_of_call(token: str | None) -> None:
    async with probe("s3cret") as (_, service), open_channel(f"127.0.0.1:{service.port}", token) as channel:
        stub = Stub(channel)
        for call in (
            lambda: stub.unary(text("x"), timeout=TIMEOUT),
            lambda: stub.gathered(iter([text("x")]), timeout=TIMEOUT),
            lambda: stub.counted(text("1"), timeout=TIMEOUT).read(),
            lambda: stub.echoed(iter([text("x")]), timeout=TIMEOUT).read(),
        ):
            error = await failure(call())
            assert isinstance(error, errors.Unauthenticated)
            assert "s3cret" not in error.detail + error.remedy


async def test_the_message_of_a_stranger_is_not_even_read() -> None:
    too_large = BytesValue(value=bytes(2 * MESSAGE_LIMIT))
    async with probe("s3cret") as (_, service):
        address = f"127.0.0.1:{service.port}"
        async with grpc.aio.insecure_channel(address, (("grpc.max_send_message_length", -1),)) as stranger:
            error = await failure(Stub(stranger).size(too_large, timeout=TIMEOUT))
        assert isinstance(error, errors.Unauthenticated)


async def test_health_needs_no_token() -> None:
    async with probe("s3cret") as (_, service), open_channel(f"127.0.0.1:{service.port}") as channel:
        health = health_pb2_grpc.HealthStub(channel)
        for name in ("", SERVICE):
            answer = await health.Check(health_pb2.HealthCheckRequest(service=name), timeout=TIMEOUT)
            assert answer.status == SERVING


@pytest.mark.parametrize("kind", errors.WIRE, ids=lambda kind: kind.__name__)
async def test_every_error_arrives_as_itself(kind: type[errors.PretouchError]) -> None:
    async with probe() as (stub, _):
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await stub.unary(text(kind.__name__), timeout=TIMEOUT)
        assert caught.value.code() is errors.WIRE[kind].grpc_code
        error = errors.from_rpc_error(caught.value)
        assert type(error) is kind
        assert (error.detail, error.remedy) == (f"{kind.__name__} happened", "do something else")
        amid = await failure(_drained(stub.echoed(iter([text("fine"), text(kind.__name__)]), timeout=TIMEOUT)))
        assert type(amid) is kind


async def _drained(stream: Any) -> None:
    async for _ in stream:
        pass


async def test_a_defect_crosses_the_wire_without_its_trace_and_is_logged_with_it() -> None:
    with structlog.testing.capture_logs() as lines:
        async with probe() as (stub, _):
            with pytest.raises(grpc.aio.AioRpcError) as caught:
                await stub.unary(text("defect"), timeout=TIMEOUT)
    assert caught.value.code() is grpc.StatusCode.INTERNAL
    seen = f"{caught.value.details()} {caught.value.debug_error_string()} {caught.value.trailing_metadata()}"
    assert not any(word in seen for word in ("secret", "ZeroDivision", "Traceback", ".py"))
    assert isinstance(errors.from_rpc_error(caught.value), errors.Internal)
    assert [repr(line["exc_info"]) for line in lines if line["log_level"] == "error"] == [
        "ZeroDivisionError('a secret of the inside')"
    ]


async def test_an_overlong_error_still_arrives() -> None:
    async with probe() as (stub, _):
        error = await failure(stub.unary(text("long"), timeout=TIMEOUT))
        assert isinstance(error, errors.InvalidInput)
        assert error.detail.startswith("ääää")


async def test_messages_up_to_32_mib_pass_both_ways_and_larger_ones_are_refused() -> None:
    fits, overhead = MESSAGE_LIMIT - 1024, 1024
    async with probe() as (stub, service):
        assert (await stub.size(BytesValue(value=bytes(fits)), timeout=TIMEOUT)).value == str(fits)
        assert len((await stub.bytes(text(str(fits)), timeout=TIMEOUT)).value) == fits
        too_large = stub.bytes(text(str(fits + overhead)), timeout=TIMEOUT)
        assert isinstance(await failure(too_large), errors.TooLarge)
        async with grpc.aio.insecure_channel(f"127.0.0.1:{service.port}") as unlimited:
            call = Stub(unlimited).size(BytesValue(value=bytes(fits + overhead)), timeout=TIMEOUT)
            assert isinstance(await failure(call), errors.TooLarge)


async def test_a_full_queue_is_refused_and_frees_up_again() -> None:
    async with probe(workers=1, max_queue=1) as (stub, service):
        held = [asyncio.create_task(_call(stub, "hold"))]
        await eventually(lambda: value(service.context, "calls_in_flight") == 1)
        held.append(asyncio.create_task(_call(stub, "hold")))
        await eventually(lambda: value(service.context, "queue_jobs") == 1)
        assert isinstance(await failure(stub.unary(text("spin:0"), timeout=TIMEOUT)), errors.Overloaded)
        held[1].cancel()  # the one that waits gives its place up
        await eventually(lambda: value(service.context, "queue_jobs") == 0)
        next_one = asyncio.create_task(_call(stub, "spin:0"))
        await eventually(lambda: value(service.context, "queue_jobs") == 1)
        (await stub.unary(text("release"), timeout=TIMEOUT))
        assert await next_one == "spin:0"
        await held[0]


async def _call(stub: Stub, request: str) -> str:
    return (await stub.unary(text(request), timeout=TIMEOUT)).value


@pytest.mark.parametrize("end", ["the client's deadline", "the service's deadline", "the client hangs up"])
async def test_a_thread_is_free_again_once_nobody_waits_for_its_work(end: str) -> None:
    async with probe(workers=1, deadline=0.3 if "service" in end else 60.0) as (stub, service):
        call = stub.unary(text("grind"), timeout=0.3 if end == "the client's deadline" else None)
        if end == "the client hangs up":
            await eventually(lambda: value(service.context, "calls_in_flight") == 1)
            call.cancel()
            with pytest.raises(asyncio.CancelledError):
                await call
        else:
            assert isinstance(await failure(call), errors.DeadlineExceeded)
        assert (await stub.unary(text("spin:0"), timeout=TIMEOUT)).value == "spin:0"


async def test_a_request_that_is_no_message_of_its_type_is_malformed() -> None:
    async with probe() as (_, service), open_channel(f"127.0.0.1:{service.port}") as channel:
        call = channel.unary_unary(f"/{SERVICE}/Unary", bytes, StringValue.FromString)
        assert isinstance(await failure(call(b"\xff\xff\xff", timeout=TIMEOUT)), errors.Malformed)


async def test_health_answers_while_every_worker_is_busy() -> None:
    async with probe(workers=2) as (stub, service), open_channel(f"127.0.0.1:{service.port}") as channel:
        busy = [asyncio.create_task(_call(stub, "spin:1")) for _ in range(2)]
        health = health_pb2_grpc.HealthStub(channel)
        await eventually(lambda: value(service.context, "calls_in_flight") == 2)
        answer = await health.Check(health_pb2.HealthCheckRequest(), timeout=TIMEOUT)
        assert answer.status == SERVING
        assert not any(task.done() for task in busy)
        await asyncio.gather(*busy)


async def test_a_call_without_a_deadline_gets_one() -> None:
    async with probe(deadline=0.1) as (stub, _):
        assert isinstance(await failure(stub.unary(text("forever"))), errors.DeadlineExceeded)
        assert await _call(stub, "wait:0.3") == "wait:0.3", "the client's own deadline goes before the default"


async def test_a_client_that_gives_up_ends_the_call() -> None:
    async with probe() as (stub, service):
        call = stub.unary(text("forever"), timeout=TIMEOUT)
        await eventually(lambda: value(service.context, "calls_in_flight") == 1)
        call.cancel()
        labels = {"method": f"{SERVICE}/Unary", "code": "CANCELLED"}
        await eventually(lambda: value(service.context, "calls_total", labels) == 1)


async def _metrics(client: httpx.AsyncClient, service: Started) -> str:
    return (await client.get(f"http://127.0.0.1:{service.metrics_port}/metrics", timeout=TIMEOUT)).text


async def test_metrics_count_calls_by_method_and_code() -> None:
    async with probe(metrics_port=0) as (stub, service), httpx.AsyncClient() as client:
        await _call(stub, "fine")
        await failure(stub.unary(text("NotFound"), timeout=TIMEOUT))
        await failure(stub.unary(text("abort"), timeout=TIMEOUT))
        await failure(_drained(stub.counted(text("1"), timeout=TIMEOUT)))
        page = await _metrics(client, service)
    for method, code in (("Unary", "OK"), ("Unary", "NOT_FOUND"), ("Unary", "DATA_LOSS"), ("Counted", "NOT_FOUND")):
        assert f'pretouch_probe_calls_total{{code="{code}",method="{SERVICE}/{method}"}} 1.0' in page
    assert f'pretouch_probe_call_seconds_count{{method="{SERVICE}/Unary"}} 3.0' in page
    assert "pretouch_probe_calls_in_flight 0.0" in page


async def test_session_and_scan_ids_reach_the_logs_context_and_not_the_next_call() -> None:
    async with probe() as (stub, _):
        metadata = (("pretouch-session-id", "s1"), ("pretouch-scan-id", "k2"))
        with_ids = await stub.unary(text("context"), metadata=metadata, timeout=TIMEOUT)
        assert json.loads(with_ids.value.replace("'", '"')) == {"session": "s1", "scan": "k2"}
        assert (await stub.unary(text("context"), timeout=TIMEOUT)).value == "{}"


async def test_health_follows_warm_up_and_drain() -> None:
    warm, entered = asyncio.Event(), asyncio.Event()
    contexts: list[ServiceContext] = []

    @asynccontextmanager
    async def slow(server: grpc.aio.Server, context: ServiceContext) -> AsyncIterator[tuple[str, ...]]:
        contexts.append(context)
        async with running(server, context) as names:
            entered.set()
            await warm.wait()
            yield names

    port: asyncio.Future[int] = asyncio.get_running_loop().create_future()
    stop = asyncio.Event()

    async def serve_until_stop() -> None:
        async with started("probe", slow, Settings(port=free, grace=TIMEOUT)) as service:
            port.set_result(service.port)
            await stop.wait()

    async with started("probe", running, Settings()) as first:
        free = first.port
    serving = asyncio.create_task(serve_until_stop())
    await entered.wait()
    async with open_channel(f"127.0.0.1:{free}") as channel:
        health, stub = health_pb2_grpc.HealthStub(channel), Stub(channel)
        watch = health.Watch(health_pb2.HealthCheckRequest(), timeout=TIMEOUT)
        assert (await watch.read()).status == NOT_SERVING
        assert isinstance(await failure(stub.unary(text("x"), timeout=TIMEOUT)), errors.Unavailable)
        warm.set()
        assert await port == free
        assert (await watch.read()).status == SERVING
        stream = stub.until_draining(text(""), timeout=TIMEOUT)
        assert (await stream.read()).value == "open"
        held = asyncio.create_task(_call(stub, "outlast"))
        await eventually(lambda: value(contexts[0], "calls_in_flight") == 2)
        kept = stub.echoed(timeout=TIMEOUT)
        await kept.write(text("holds the drain open"))
        assert (await kept.read()).value == "holds the drain open"
        stop.set()
        assert (await watch.read()).status == NOT_SERVING
        assert isinstance(await failure(stub.unary(text("x"), timeout=TIMEOUT)), errors.Unavailable)
        check = await health.Check(health_pb2.HealthCheckRequest(), timeout=TIMEOUT)
        assert check.status == NOT_SERVING
        assert (await stream.read()).value == "draining"
        assert await held == "outlast", "a call under way ends well"
        await kept.done_writing()
        assert await kept.read() is grpc.aio.EOF
        await serving


async def test_reflection_names_the_services() -> None:
    async with probe() as (_, service), open_channel(f"127.0.0.1:{service.port}") as channel:
        reflection = reflection_pb2_grpc.ServerReflectionStub(channel)
        stream = reflection.ServerReflectionInfo(
            iter([reflection_pb2.ServerReflectionRequest(list_services="")]), timeout=TIMEOUT
        )
        names = {entry.name for entry in (await stream.read()).list_services_response.service}
        assert {SERVICE, "grpc.health.v1.Health"} <= names


async def test_a_taken_port_is_a_clear_error() -> None:
    async with probe(metrics_port=0) as (_, service):
        for settings in (Settings(port=service.port), Settings(metrics_port=service.metrics_port)):
            with pytest.raises(errors.Unavailable, match=r"cannot listen on 127\.0\.0\.1"):
                async with started("probe", running, settings):
                    pass


@pytest.mark.parametrize(("token", "said"), [(None, ["anyone", "unencrypted"]), ("t", ["unencrypted"])])
async def test_what_is_open_to_other_machines_is_said_in_warnings(token: str | None, said: list[str]) -> None:
    with structlog.testing.capture_logs() as lines:
        async with started("probe", running, Settings(host="0.0.0.0", token=token)):
            pass
    warnings = [line for line in lines if line["log_level"] == "warning"]
    assert len(warnings) == len(said)
    for line, word in zip(warnings, said, strict=True):
        assert word in line["event"]
        assert line["host"] == "0.0.0.0"


async def test_metrics_ask_for_the_token_unless_told_otherwise() -> None:
    async with probe("s3cret", metrics_port=0) as (_, service), httpx.AsyncClient(trust_env=False) as client:
        url = f"http://127.0.0.1:{service.metrics_port}/metrics"
        refused = await client.get(url, timeout=TIMEOUT)
        assert refused.status_code == 401
        assert refused.headers["www-authenticate"] == "Bearer"
        assert "pretouch_probe_calls" not in refused.text
        allowed = await client.get(url, timeout=TIMEOUT, headers={"Authorization": "bearer s3cret"})
        assert "pretouch_probe_calls" in allowed.text
    async with (
        probe("s3cret", metrics_port=0, open_metrics=True) as (_, service),
        httpx.AsyncClient(trust_env=False) as client,
    ):
        assert "pretouch_probe_calls" in await _metrics(client, service)


async def test_metrics_answer_while_silent_connections_are_held() -> None:
    async with probe(metrics_port=0) as (_, service), httpx.AsyncClient(trust_env=False) as client:
        held = [await asyncio.open_connection("127.0.0.1", service.metrics_port) for _ in range(15)]
        assert "pretouch_probe_calls" in await _metrics(client, service)
        for _, writer in held:
            writer.close()


async def test_a_call_before_the_warm_up_has_ended_is_told_to_try_again() -> None:
    warm, entered = asyncio.Event(), asyncio.Event()

    @asynccontextmanager
    async def slow(server: grpc.aio.Server, context: ServiceContext) -> AsyncIterator[tuple[str, ...]]:
        entered.set()
        await warm.wait()
        async with running(server, context) as names:
            yield names

    async with started("probe", running, Settings()) as service:
        port = service.port

    async def serve_slowly() -> None:
        async with started("probe", slow, Settings(port=port)):
            pass

    serving = asyncio.create_task(serve_slowly())
    await entered.wait()
    async with open_channel(f"127.0.0.1:{port}") as channel:
        error = await failure(Stub(channel).unary(text("x"), timeout=TIMEOUT))
    assert isinstance(error, errors.Unavailable), "its methods are not known yet, which is no fault of the caller"
    assert "warming up" in error.detail
    warm.set()
    await serving
