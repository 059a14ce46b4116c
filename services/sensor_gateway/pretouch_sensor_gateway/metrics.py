"""The devices' counts for Prometheus."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from pretouch_sensor_gateway.device import Device, DeviceState, DeviceStatus

_COUNTS: tuple[tuple[str, str, Callable[[DeviceStatus], int]], ...] = (
    ("frames", "Good frames of a device.", lambda status: status.frames),
    ("bad_frames", "Frames of a device that were refused.", lambda status: status.bad_frames),
    ("lost_frames", "Frames of a device missing by sequence number.", lambda status: status.lost_frames),
)


class DeviceCollector(Collector):
    """Reads each device's counts when Prometheus asks; names start with `prefix`."""

    def __init__(self, devices: Sequence[Device], prefix: str) -> None:
        self._devices = devices
        self._prefix = prefix

    def collect(self) -> Iterable[Metric]:
        statuses = {device.name: device.status() for device in self._devices}
        for name, text, count in _COUNTS:
            counter = CounterMetricFamily(f"{self._prefix}_{name}", text, labels=("device",))
            for device, status in statuses.items():
                counter.add_metric((device,), count(status))
            yield counter
        streaming = GaugeMetricFamily(f"{self._prefix}_device_streaming", "1 while frames arrive.", labels=("device",))
        for device, status in statuses.items():
            streaming.add_metric((device,), status.state is DeviceState.STREAMING)
        yield streaming
