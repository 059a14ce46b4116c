"""Sends a service's spans to an OpenTelemetry collector, where one is named."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from pretouch.errors import Unavailable
from pretouch.tracing import record_with

_ENDPOINTS = ("OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT")
_FLUSH = 2.0
"""s that the last spans get to be sent."""


@contextmanager
def recording_spans(service: str) -> Iterator[None]:
    """Records the block's spans, as `pretouch-<service>`, if OTEL_EXPORTER_OTLP_ENDPOINT names a collector (gRPC).

    The SDK reads its other variables too: OTEL_SERVICE_NAME, OTEL_RESOURCE_ATTRIBUTES, OTEL_TRACES_SAMPLER and more.

    Raises:
        Unavailable: a collector is named, but the extra `tracing` is not installed.
    """
    if not any(os.environ.get(name) for name in _ENDPOINTS):
        yield
        return
    try:
        from opentelemetry.exporter.otlp.proto.grpc.trace_exporter import OTLPSpanExporter
        from opentelemetry.sdk.resources import OTELResourceDetector, Resource
        from opentelemetry.sdk.trace import TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor
    except ModuleNotFoundError as error:
        raise Unavailable(
            f"{_ENDPOINTS[0]} is set, but the package {error.name} is not installed.",
            "Run: pip install 'pretouch[tracing]', or unset it.",
        ) from error
    resource = Resource.create({"service.name": f"pretouch-{service}"}).merge(OTELResourceDetector().detect())
    provider = TracerProvider(resource=resource, shutdown_on_exit=False)
    exporter = OTLPSpanExporter()
    provider.add_span_processor(BatchSpanProcessor(exporter))
    record_with(provider.get_tracer("pretouch"))
    try:
        yield
    finally:
        record_with(None)
        closing = threading.Thread(target=provider.shutdown, daemon=True)
        closing.start()
        closing.join(_FLUSH)
        if closing.is_alive():
            exporter.shutdown()  # ends the repeated tries to reach a collector that is away
