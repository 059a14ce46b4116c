"""A collector of OpenTelemetry traces over gRPC, which keeps what services send it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Self

import grpc
from opentelemetry.proto.collector.trace.v1 import trace_service_pb2 as pb
from opentelemetry.proto.collector.trace.v1 import trace_service_pb2_grpc as pb_grpc


@dataclass(frozen=True)
class Span:
    """A span as it arrived; ids in hexadecimal."""

    service: str
    name: str
    trace_id: str
    id: str
    parent_id: str


class TraceCollector(pb_grpc.TraceServiceServicer):
    """Use it in a `with` block; `endpoint` is for OTEL_EXPORTER_OTLP_ENDPOINT."""

    def __init__(self) -> None:
        self.spans: list[Span] = []
        self._server = grpc.server(ThreadPoolExecutor(4))
        pb_grpc.add_TraceServiceServicer_to_server(self, self._server)  # type: ignore[no-untyped-call]
        self.endpoint = f"http://127.0.0.1:{self._server.add_insecure_port('127.0.0.1:0')}"

    def __enter__(self) -> Self:
        self._server.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.stop(None).wait()

    def Export(self, request: Any, context: Any) -> pb.ExportTraceServiceResponse:
        for each in request.resource_spans:
            (service,) = (a.value.string_value for a in each.resource.attributes if a.key == "service.name")
            for scope in each.scope_spans:
                self.spans += [
                    Span(service, s.name, s.trace_id.hex(), s.span_id.hex(), s.parent_span_id.hex())
                    for s in scope.spans
                ]
        return pb.ExportTraceServiceResponse()

    def path_to(self, name: str, trace_id: str) -> list[tuple[str, str]]:
        """Service and name of the trace's first span of this name, and of its ancestors; empty until all are there."""
        spans = {span.id: span for span in self.spans if span.trace_id == trace_id}
        found = next((span for span in spans.values() if span.name == name), None)
        path = []
        while found is not None:
            path.append((found.service, found.name))
            last, found = found, spans.get(found.parent_id)
            if found is None and last.parent_id:
                path.append(("", last.parent_id))
        return path
