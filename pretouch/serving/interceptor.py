"""The server interceptor of all gRPC calls but health checks: log context, metrics, token, deadline, problems."""

from __future__ import annotations

import asyncio
import inspect
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable
from contextlib import asynccontextmanager
from typing import Any

import grpc
import grpc.aio
import structlog
from google.protobuf.message import DecodeError

from pretouch.channel import SCAN_ID_METADATA, SESSION_ID_METADATA
from pretouch.errors import PROBLEM_METADATA_KEY, Internal, Malformed, PretouchError, problem, wire_of
from pretouch.serving.admission import AdmissionControl
from pretouch.serving.context import ServiceContext

_HEALTH = "/grpc.health.v1.Health/"
_DETAIL_LENGTH, _MESSAGE_LENGTH = 800, 150  # characters; gRPC refuses metadata beyond 8 KiB, however it is encoded
_LOGGED_IDS = ((SESSION_ID_METADATA, "session"), (SCAN_ID_METADATA, "scan"))


class CallInterceptor(grpc.aio.ServerInterceptor):  # type: ignore[misc]
    """Wraps the handlers of all four kinds of call."""

    def __init__(self, service: ServiceContext, admission: AdmissionControl) -> None:
        self._service = service
        self._admission = admission

    async def intercept_service(
        self, continuation: Callable[[grpc.HandlerCallDetails], Awaitable[Any]], details: grpc.HandlerCallDetails
    ) -> Any:
        """The method's handler, surrounded; a health check's and an unknown method's as they are."""
        handler = await continuation(details)
        if handler is None or details.method.startswith(_HEALTH):
            return handler
        refusal = self._admission.refusal(_texts(details.invocation_metadata).get("authorization", ""))
        if refusal is not None:
            handler = _refuse_unread(refusal)
        return self._surround(handler, details.method.removeprefix("/"))

    def _surround(self, handler: Any, method: str) -> Any:
        kinds = ("unary_unary", "unary_stream") if not handler.request_streaming else ("stream_unary", "stream_stream")
        kind = kinds[bool(handler.response_streaming)]
        behaviour = getattr(handler, kind)
        check: Callable[[Any], Any] = _check_each if handler.request_streaming else _check_readable

        async def single_answer(request: Any, context: grpc.aio.ServicerContext) -> Any:
            async with self._around(method, context, self._service.settings.deadline):
                return await behaviour(check(request), context)

        async def many_answers(request: Any, context: grpc.aio.ServicerContext) -> AsyncIterator[Any]:
            async with self._around(method, context, None):
                answers = behaviour(check(request), context)
                if inspect.isawaitable(answers):  # a handler that calls context.write itself
                    await answers
                    return
                async for answer in answers:
                    yield answer

        wrap = getattr(grpc, f"{kind}_rpc_method_handler")
        return wrap(
            many_answers if handler.response_streaming else single_answer,
            request_deserializer=handler.request_deserializer and _keep_unreadable(handler.request_deserializer),
            response_serializer=handler.response_serializer,
        )

    @asynccontextmanager
    async def _around(
        self, method: str, context: grpc.aio.ServicerContext, deadline: float | None
    ) -> AsyncIterator[None]:
        metadata = _texts(context.invocation_metadata())
        ids = {name: metadata[key][:64] for key, name in _LOGGED_IDS if key in metadata}
        metrics = self._service.metrics
        began = time.perf_counter()
        code = grpc.StatusCode.OK
        with (
            structlog.contextvars.bound_contextvars(**ids),
            metrics.calls_in_flight.track_inprogress(),
            self._admission.track_call(),
        ):
            try:
                async with self._admission.limit_duration(deadline if context.time_remaining() is None else None):
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
                metrics.calls.labels(method, code.name).inc()
                metrics.call_seconds.labels(method).observe(seconds)
                self._service.log.info("call", method=method, code=code.name, seconds=round(seconds, 6))

    def _log_unless_known(self, method: str, caught: Exception) -> PretouchError:
        """`caught` itself if it may cross the wire; any other goes to the log with its trace."""
        if isinstance(caught, PretouchError) and not isinstance(caught, Internal):
            return caught
        self._service.log.error("a call met a defect", method=method, exc_info=caught)
        if isinstance(caught, PretouchError):
            return caught
        return Internal(
            "The service met a defect of its own.",
            "Report it with the service's log of this moment; the request may be sent again.",
        )


def _texts(metadata: Iterable[tuple[str, Any]] | None) -> dict[str, str]:
    return {key: value for key, value in metadata or () if isinstance(value, str)}


def _keep_unreadable(deserialise: Callable[[bytes], Any]) -> Callable[[bytes], Any]:
    """Hands on the error of bytes that are no message, instead of raising it where gRPC would answer UNKNOWN."""

    def read(data: bytes) -> Any:
        try:
            return deserialise(data)
        except DecodeError as error:
            return Malformed(f"The message cannot be read: {error}.", "Send what the service's .proto file describes.")

    return read


def _check_readable(request: Any) -> Any:
    if isinstance(request, Malformed):
        raise request
    return request


async def _check_each(requests: AsyncIterator[Any]) -> AsyncIterator[Any]:
    async for request in requests:
        yield _check_readable(request)


def _refuse_unread(refusal: PretouchError) -> Any:
    """A handler that refuses any kind of call; as a stream it need not read the request first."""

    async def refuse(_: Any, __: Any) -> None:
        raise refusal

    return grpc.stream_stream_rpc_method_handler(refuse)


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
