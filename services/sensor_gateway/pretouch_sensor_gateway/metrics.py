"""The devices' counts for Prometheus."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from pretouch_sensor_gateway.device import Device, DeviceStatus
from pretouch_sensor_gateway.source import DeviceState

_COUNTS: tuple[tuple[str, str, Callable[[DeviceStatus], int]], ...] = (
    ("frames", "Good frames of a device.", lambda status: status.source.measurements),
    ("bad_frames", "Frames of a device that were refused.", lambda status: status.source.refused.total()),
    ("lost_frames", "Frames of a device missing by sequence number.", lambda status: status.source.lost),
    ("untimed_frames", "Good frames given up for want of a clock.", lambda status: status.source.untimed),
    ("overrun_frames", "Frames that slow listeners lost.", lambda status: status.overrun),
    ("device_starts", "Starts of a device that were noticed.", lambda status: status.source.epoch),
    ("port_opened", "Times that a device's port was opened.", lambda status: status.source.connections),
)
_GAUGES: tuple[tuple[str, str, Callable[[DeviceStatus], float]], ...] = (
    ("device_streaming", "1 while frames arrive.", lambda status: status.source.state is DeviceState.STREAMING),
    ("device_rate", "Frames a second.", lambda status: status.rate),
    ("clock_std_seconds", "One standard deviation of a frame's time.", lambda status: status.source.clock.std),
    ("clock_drift", "Seconds a second by which a device's clock is fast.", lambda status: status.source.clock.drift),
    ("listeners", "Streams open at this moment.", lambda status: status.subscribers),
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
        for name, text, value in _GAUGES:
            gauge = GaugeMetricFamily(f"{self._prefix}_{name}", text, labels=("device",))
            for device, status in statuses.items():
                gauge.add_metric((device,), value(status))
            yield gauge
        yield from self._recordings()

    def _recordings(self) -> Iterable[Metric]:
        unrecorded = CounterMetricFamily(
            f"{self._prefix}_unrecorded_frames", "Frames that could not be recorded.", labels=("device",)
        )
        for device in self._devices:
            if device.recorder is not None:
                unrecorded.add_metric((device.name,), device.recorder.status().unrecorded)
        yield unrecorded
