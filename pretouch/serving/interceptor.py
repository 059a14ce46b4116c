"""The server interceptor of all gRPC calls but health checks: log context, metrics, token, deadline, problems."""

from __future__ import annotations

import asyncio
import inspect
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable
from contextlib import asynccontextmanager
from functools import partial
from typing import Any, cast
from urllib.parse import unquote

import grpc
import grpc.aio
import structlog
from google.protobuf.message import DecodeError

from pretouch.channel import MESSAGE_LIMIT, SCAN_ID_METADATA, SESSION_ID_METADATA
from pretouch.errors import (
    PROBLEM_METADATA_KEY,
    DeadlineExceeded,
    Internal,
    InvalidInput,
    Malformed,
    Overloaded,
    PretouchError,
    problem,
    wire_of,
)
from pretouch.serving.admission import AdmissionControl
from pretouch.serving.caller import Caller, forbid_change, set_caller
from pretouch.serving.context import ServiceContext
from pretouch.serving.memory import MemoryBudget
from pretouch.tracing import server_span

_HEALTH = "/grpc.health.v1.Health/"
_DETAIL_LENGTH, _MESSAGE_LENGTH = 800, 150  # characters; gRPC refuses metadata beyond 8 KiB, however it is encoded
_COPIES_READ, _COPIES_HELD = 3, 2
"""How often a message is in memory while it is parsed (gRPC's buffers, bytes, message), and while it is worked on."""
_WITH_IMAGES = {"CreateSession", "Propose", "Register", "PredictScans"}
"""Methods whose requests may hold an image: others are not kept waiting by them."""
_PATIENCE, _READ_WITHIN = 5.0, 20.0  # s
_FAILURES = (grpc.StatusCode.INTERNAL, grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.DEADLINE_EXCEEDED)
_LOGGED_IDS = ((SESSION_ID_METADATA, "session"), (SCAN_ID_METADATA, "scan"))


class CallInterceptor(grpc.aio.ServerInterceptor):  # type: ignore[misc]
    """Wraps the handlers of all four kinds of call."""

    def __init__(self, service: ServiceContext, admission: AdmissionControl) -> None:
        self._service = service
        self._admission = admission

    async def intercept_service(
        self, continuation: Callable[[grpc.HandlerCallDetails], Awaitable[Any]], details: grpc.HandlerCallDetails
    ) -> Any:
        """The method's handler, surrounded; a health check's and an unknown method's as they are.

        While the service warms up its methods are not known yet: calls are then told to try again.
        """
        handler = await continuation(details)
        if details.method.startswith(_HEALTH):
            return handler
        if handler is None:
            closed = self._admission.closed
            return (
                None if closed is None else self._surround(_refuse_unread(lambda _: closed), details.method, Caller())
            )
        authorization = _texts(details.invocation_metadata).get("authorization", "").encode()
        caller = self._service.token_check.identify(authorization)
        refusal: PretouchError | None
        if caller is None:
            handler = _refuse_unread(lambda address: self._service.token_check.refuse(authorization, address))
        elif caller.read_only and not _only_reads(details.method):
            handler = _refuse_unread(lambda _: forbid_change())
        elif (refusal := self._admission.admit(cast("asyncio.Task[Any]", asyncio.current_task()))) is not None:
            handler = _refuse_unread(lambda _: refusal)
        return self._surround(handler, details.method.removeprefix("/"), caller or Caller())

    def _surround(self, handler: Any, method: str, caller: Caller) -> Any:
        """Takes every kind of call as a stream of requests: a single one is then read once there is memory for it."""
        kinds = ("unary_unary", "unary_stream") if not handler.request_streaming else ("stream_unary", "stream_stream")
        behaviour = getattr(handler, kinds[bool(handler.response_streaming)])
        with_images = method.rpartition("/")[2] in _WITH_IMAGES
        budget = self._service.messages if with_images else self._service.short_messages
        read = _pass_on if handler.request_streaming else partial(_read_single, budget)

        async def single_answer(requests: AsyncIterator[Any], context: grpc.aio.ServicerContext) -> Any:
            deadline = self._service.settings.deadline
            async with self._around(method, caller, context, deadline), read(requests) as request:
                return await behaviour(request, context)

        async def many_answers(requests: AsyncIterator[Any], context: grpc.aio.ServicerContext) -> AsyncIterator[Any]:
            async with self._around(method, caller, context, None), read(requests) as request:
                answers = behaviour(request, context)
                if inspect.isawaitable(answers):  # a handler that calls context.write itself
                    await answers
                    return
                async for answer in answers:
                    yield answer

        kind = "stream_stream" if handler.response_streaming else "stream_unary"
        wrap = getattr(grpc, f"{kind}_rpc_method_handler")
        return wrap(
            many_answers if handler.response_streaming else single_answer,
            request_deserializer=handler.request_deserializer,
            response_serializer=handler.response_serializer,
        )

    @asynccontextmanager
    async def _around(
        self, method: str, caller: Caller, context: grpc.aio.ServicerContext, deadline: float | None
    ) -> AsyncIterator[None]:
        set_caller(caller)
        metadata = _texts(context.invocation_metadata())
        ids = {name: metadata[key][:64] for key, name in _LOGGED_IDS if key in metadata}
        metrics = self._service.metrics
        began = time.perf_counter()
        code = grpc.StatusCode.OK
        with (
            server_span(method, metadata, {"rpc.system": "grpc", "rpc.method": method} | ids) as span,
            structlog.contextvars.bound_contextvars(**ids),
            metrics.calls_in_flight.track_inprogress(),
            self._admission.track_call(),
        ):
            try:
                remaining = context.time_remaining()  # the client's own deadline, at which it stops listening
                async with self._admission.limit_duration(deadline if remaining is None else max(remaining, 0.0)):
                    yield
            except (asyncio.CancelledError, GeneratorExit):
                code = grpc.StatusCode.CANCELLED
                raise
            except grpc.aio.AbortError:
                code = context.code()
                raise
            except Exception as caught:
                error = self._log_unless_known(method, caught)
                code = wire_of(error).grpc_code
                await _abort(context, error)
            finally:
                seconds = time.perf_counter() - began
                span.end_with({"rpc.grpc.status_code": code.value[0]}, failed=code in _FAILURES)
                metrics.calls.labels(method, code.name).inc()
                metrics.call_seconds.labels(method).observe(seconds)
                self._service.log.info("call", method=method, code=code.name, seconds=round(seconds, 6))

    def _log_unless_known(self, method: str, caught: Exception) -> PretouchError:
        """`caught` itself if it may cross the wire; any other goes to the log with its trace."""
        if isinstance(caught, MemoryError):
            return Overloaded("The service has run out of memory.", "Try again shortly, or ask for less.")
        if isinstance(caught, DecodeError):
            return Malformed("The request's bytes are no message of its type.", "Send it as .proto says.")
        if isinstance(caught, PretouchError) and not isinstance(caught, Internal):
            return caught
        self._service.log.error("a call met a defect", method=method, exc_info=caught)
        if isinstance(caught, PretouchError):
            return caught
        return Internal(
            "The service met a defect of its own.",
            "Report it with the service's log of this moment; the request may be sent again.",
        )


@asynccontextmanager
async def _read_single(budget: MemoryBudget, requests: AsyncIterator[Any]) -> AsyncIterator[Any]:
    """The call's only request, with memory for it for as long as the block lasts."""
    async with budget.reserve(min(_COPIES_READ * MESSAGE_LIMIT, budget.limit), _PATIENCE) as held:
        try:
            async with asyncio.timeout(_READ_WITHIN):
                request = await anext(requests, None)
        except TimeoutError as error:
            raise DeadlineExceeded(
                f"The request did not arrive within {_READ_WITHIN:g} s.", "Send it without pausing."
            ) from error
        if request is None:
            raise InvalidInput("The call has no request.", "Send one message.")
        held.shrink(_COPIES_HELD * request.ByteSize())
        yield request


@asynccontextmanager
async def _pass_on(requests: AsyncIterator[Any]) -> AsyncIterator[Any]:
    """The stream itself: its messages are small, and its handler reads them one by one."""
    yield requests


def _texts(metadata: Iterable[tuple[str, Any]] | None) -> dict[str, str]:
    return {key: value for key, value in metadata or () if isinstance(value, str)}


def _only_reads(method: str) -> bool:
    """Whether a call of this method changes nothing: our names say it."""
    service, _, name = method.rpartition("/")
    return name.startswith(("Get", "List", "Stream")) or service.startswith("/grpc.reflection.")


def _refuse_unread(make_error: Callable[[str], PretouchError]) -> Any:
    """A handler that refuses any kind of call by an error for the caller's address; as a stream it need not read."""

    async def refuse(_: Any, context: grpc.aio.ServicerContext) -> None:
        raise make_error(_get_address(context.peer()))

    return grpc.stream_stream_rpc_method_handler(refuse)


def _get_address(peer: str) -> str:
    """The address of `ipv4:address:port`, or of `ipv6:[address]:port` with its brackets percent-encoded."""
    return unquote(peer.partition(":")[2].rpartition(":")[0]).strip("[]")


async def _abort(context: grpc.aio.ServicerContext, error: PretouchError) -> None:
    document = problem(error)
    for member in ("detail", "remedy"):
        document[member] = _shorten(document[member], _DETAIL_LENGTH)
    await context.abort(
        wire_of(error).grpc_code,
        _shorten(error.detail, _MESSAGE_LENGTH),
        ((PROBLEM_METADATA_KEY, json.dumps(document, ensure_ascii=False).encode()),),
    )


def _shorten(text: str, length: int) -> str:
    return text if len(text) <= length else text[: length - 1] + "…"
