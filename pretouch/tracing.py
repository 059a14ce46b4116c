"""Traces by OpenTelemetry: spans, and the context that travels with calls.

Services record spans once `pretouch.serving.tracing` has started that. A robot program needs nothing of this module:
its current span, if it has one, goes along with the calls of `pretouch.client`. Where neither is the case, nothing of
OpenTelemetry is imported, and nothing is done.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from opentelemetry.trace import Tracer

_tracer: Tracer | None = None


def record_with(tracer: Tracer | None) -> None:
    """Lets this process record its spans with `tracer`; None: no more."""
    global _tracer
    _tracer = tracer


def propagated() -> dict[str, str]:
    """The headers, or metadata, that make the callee's spans children of the current one; empty if there is none."""
    if "opentelemetry.trace" not in sys.modules:
        return {}
    from opentelemetry import propagate

    carrier: dict[str, str] = {}
    propagate.inject(carrier)
    return carrier


def current_ids() -> dict[str, str]:
    """The current span's `trace_id` and `span_id` in hexadecimal, for a log line; empty if there is none."""
    if _tracer is None:
        return {}
    from opentelemetry import trace

    context = trace.get_current_span().get_span_context()
    if not context.is_valid:
        return {}
    return {"trace_id": trace.format_trace_id(context.trace_id), "span_id": trace.format_span_id(context.span_id)}


@contextmanager
def span(name: str, attributes: Mapping[str, Any] | None = None, *, client: bool = False) -> Iterator[None]:
    """A span around the block, below the current one.

    Args:
        client: it is a call to another service.
    """
    if _tracer is None:
        yield
        return
    from opentelemetry.trace import SpanKind

    kind = SpanKind.CLIENT if client else SpanKind.INTERNAL
    with _tracer.start_as_current_span(name, kind=kind, attributes=attributes):
        yield


class ServerSpan:
    """What is said of the span of a call that is served."""

    def __init__(self, recorded: Any = None) -> None:
        self._recorded = recorded

    def end_with(self, attributes: Mapping[str, Any], *, name: str | None = None, failed: bool = False) -> None:
        """Adds how the call ended."""
        if self._recorded is None:
            return
        from opentelemetry.trace import StatusCode

        self._recorded.set_attributes(attributes)
        if name is not None:
            self._recorded.update_name(name)
        if failed:
            self._recorded.set_status(StatusCode.ERROR)


_UNRECORDED = ServerSpan()


@contextmanager
def server_span(name: str, headers: Mapping[str, str], attributes: Mapping[str, Any]) -> Iterator[ServerSpan]:
    """A span around a call that is served, below the caller's span that `headers`, in lower case, may name."""
    if _tracer is None:
        yield _UNRECORDED
        return
    from opentelemetry import propagate
    from opentelemetry.trace import SpanKind

    with _tracer.start_as_current_span(
        name, context=propagate.extract(headers), kind=SpanKind.SERVER, attributes=attributes
    ) as recorded:
        yield ServerSpan(recorded)
