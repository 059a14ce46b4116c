"""Prometheus metrics, named `pretouch_<service>_<noun>_<unit>`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, PlatformCollector, ProcessCollector

_SECONDS = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)


class Metrics:
    """A service's own registry and the metrics that every service has.

    `registry` can be handed to another exporter, such as a REST server's `/metrics`.
    """

    def __init__(self, service: str) -> None:
        self._prefix = f"pretouch_{service}_"
        self.registry = CollectorRegistry()
        ProcessCollector(registry=self.registry)
        PlatformCollector(registry=self.registry)
        self.calls = self.counter("calls", "gRPC calls that ended.", ("method", "code"))
        self.call_seconds = self.histogram("call_seconds", "Duration of gRPC calls.", ("method",))
        self.calls_in_flight = self.gauge("calls_in_flight", "gRPC calls under way.")

    def counter(self, name: str, help: str, labels: Iterable[str] = ()) -> Counter:
        """A counter `pretouch_<service>_<name>_total`."""
        return Counter(self._prefix + name, help, tuple(labels), registry=self.registry)

    def gauge(self, name: str, help: str, labels: Iterable[str] = ()) -> Gauge:
        """A gauge `pretouch_<service>_<name>`."""
        return Gauge(self._prefix + name, help, tuple(labels), registry=self.registry)

    def histogram(
        self, name: str, help: str, labels: Iterable[str] = (), buckets: Sequence[float] = _SECONDS
    ) -> Histogram:
        """A histogram `pretouch_<service>_<name>`; the default buckets are seconds."""
        return Histogram(self._prefix + name, help, tuple(labels), registry=self.registry, buckets=buckets)
