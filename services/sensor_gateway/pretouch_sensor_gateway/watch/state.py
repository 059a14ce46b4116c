"""The state of a gateway and its devices, updated from its messages. Times are s of one steady clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import array_from_proto
from pretouch_sensor_gateway.watch.events import EventLog, Severity
from pretouch_sensor_gateway.watch.trace import Trace

STATES = {
    pb.DEVICE_STATE_UNSPECIFIED: "unknown",
    pb.DEVICE_STATE_CONNECTING: "connecting",
    pb.DEVICE_STATE_STREAMING: "streaming",
    pb.DEVICE_STATE_SILENT: "silent",
    pb.DEVICE_STATE_ENDED: "ended",
}
_SEVERITIES = {pb.DEVICE_STATE_STREAMING: Severity.GOOD, pb.DEVICE_STATE_SILENT: Severity.BAD}


@dataclass(frozen=True)
class Reading:
    """A module's newest range (m along its beam, NaN for none), status code, and flags as in RangeBatch."""

    range: float
    code: int
    flags: int


class WatchedDevice:
    """One device.

    Attributes:
        status: the last that the gateway sent.
        state_since: since when it has been in its state, as far as it was watched.
        trace: its recent ranges.
    """

    def __init__(self, device: pb.Device, events: EventLog, at: float) -> None:
        self.name = device.name
        self.status = pb.GetStatusResponse(device=device)
        self.state_since = at
        self.trace = Trace(0)
        self._last: list[Reading] = []
        self._events = events
        self._known = False  # whether `status` came from GetStatus, rather than from ListDevices
        self._epoch: int | None = None
        self._newest = (0.0, at)  # the newest measurement's time on the gateway, and when it came
        self._noted_state = pb.DEVICE_STATE_UNSPECIFIED
        self._noted_problem = ""

    def take_status(self, status: pb.GetStatusResponse, at: float) -> None:
        """Takes a status of the device."""
        before, self.status = self.status, status
        self._note_state(at)
        self._note_epoch(status.epoch, at)
        if self._known:
            self._note_changes(before, at)
        self._known = True

    def take_ranges(self, response: pb.StreamRangesResponse, at: float) -> None:
        """Takes measurements of the device.

        Raises:
            InvalidInput: an array is not of its stated shape and type.
        """
        batch = response.batch
        t, ranges, code, flags = (
            array_from_proto(getattr(batch, name), name) for name in ("t", "range", "status", "flags")
        )
        if response.overrun:
            self._count("overrun", response.overrun, at, "{} lost to this view, which read too slowly")
        if batch.lost:
            self._count("lost", batch.lost, at, "{} lost", " in {} gaps")
        self._note_epoch(batch.epoch, at)
        if not len(t):
            return
        if ranges.shape[1] != self.trace.modules:
            self.trace = Trace(ranges.shape[1])
        self.trace.add(t, np.where(code == 0, ranges, np.nan))
        newest = zip(ranges[-1].tolist(), code[-1].tolist(), flags[-1].tolist(), strict=True)
        self._last = [Reading(*values) for values in newest]
        self._newest = (float(t[-1]), at)

    @property
    def readings(self) -> list[Reading]:
        """Each module's newest measurement: from the stream, or from the status if none was streamed yet."""
        return self._last or [Reading(module.range, module.status, 0) for module in self.status.modules]

    def gateway_time(self, at: float) -> float:
        """Unix time of the gateway's clock, s, estimated from the newest measurement."""
        newest, came = self._newest
        return newest + at - came

    def forget_counts(self) -> None:
        """Forgets all counts: the gateway was away and may have restarted, so new counts do not continue old ones."""
        self._known = False
        self._epoch = None

    def _note_state(self, at: float) -> None:
        device = self.status.device
        if device.state != self._noted_state:
            self._noted_state, self.state_since = device.state, at
            text = f"{STATES[device.state]}: {device.problem}" if device.problem else STATES[device.state]
            self._events.add(self.name, text, _SEVERITIES.get(device.state, Severity.NOTE), at)
        elif device.problem and device.problem != self._noted_problem:
            self._events.add(self.name, device.problem, Severity.BAD, at)
        self._noted_problem = device.problem

    def _note_epoch(self, epoch: int, at: float) -> None:
        """Notes a new epoch when a batch or a status first has it; later ones may still have an old epoch."""
        if self._epoch is not None and epoch > self._epoch:
            self._events.add(self.name, f"restarted: epoch {epoch}", Severity.NOTE, at)
        self._epoch = epoch if self._epoch is None else max(self._epoch, epoch)

    def _note_changes(self, before: pb.GetStatusResponse, at: float) -> None:
        now = self.status
        for reason, count in now.refused.items():
            if count > before.refused.get(reason, 0):
                self._count(reason, count - before.refused.get(reason, 0), at, f"{{}} refused: {reason}")
        if now.untimed > before.untimed:
            self._count("untimed", now.untimed - before.untimed, at, "{} given up, their time was not known")
        if now.clock.synchronised != before.clock.synchronised:
            if now.clock.synchronised:
                self._events.add(self.name, "its clock is known", Severity.GOOD, at)
            else:
                self._events.add(self.name, "its clock is not known", Severity.BAD, at)
        if now.host_clock_jumps > before.host_clock_jumps:
            self._events.add(self.name, "the clock of the gateway's host jumped", Severity.BAD, at)
        self._note_recording(before.recording, now.recording, at)

    def _note_recording(self, before: pb.RecordingStatus, now: pb.RecordingStatus, at: float) -> None:
        if now.on and now.path and now.path != before.path:
            self._events.add(self.name, f"recording to {now.path}", Severity.NOTE, at)
        elif before.on and not now.on:
            self._events.add(self.name, "recording stopped", Severity.NOTE, at)
        if now.problem and now.problem != before.problem:
            self._events.add(self.name, f"recording: {now.problem}", Severity.BAD, at)

    def _count(self, what: str, frames: int, at: float, text: str, again: str = "") -> None:
        def describe(total: int, times: int) -> str:
            frames = "1 frame" if total == 1 else f"{total:,} frames"
            return text.format(frames) + (again.format(times) if times > 1 else "")

        self._events.count(self.name, what, frames, at, describe)


class Watch:
    """A gateway that is watched.

    Attributes:
        address: where it is.
        connected: whether it answers at present.
        heard: whether it ever answered.
        problem: why it does not answer, "" if it does, or was never tried.
        retry_at: when it is tried again, if there is a problem.
        devices: those watched, in the gateway's order.
        events: of the gateway and all devices.
        changes: counts updates.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self.connected = self.heard = False
        self.problem = ""
        self.retry_at = -float("inf")
        self.devices: list[WatchedDevice] = []
        self.events = EventLog()
        self.changes = 0
        self._selected = 0

    def take_devices(self, devices: Sequence[pb.Device], at: float) -> None:
        """Takes the gateway's devices: it answers."""
        if self.heard and not self.connected:
            self.events.add("", f"the gateway at {self.address} is back", Severity.GOOD, at)
        self.connected = self.heard = True
        self.problem = ""
        known = {device.name: device for device in self.devices}
        self.devices = [known.get(device.name) or WatchedDevice(device, self.events, at) for device in devices]
        for device in self.devices:
            device.forget_counts()
        self.changes += 1

    def take_failure(self, problem: str, retry_at: float, at: float) -> None:
        """Takes a failure: the gateway does not answer."""
        if self.problem != problem:
            self.events.add("", problem, Severity.BAD, at)
        self.connected = False
        self.problem, self.retry_at = problem, retry_at
        self.changes += 1

    @property
    def selected(self) -> WatchedDevice | None:
        """The device on the screen; None if there is none."""
        return self.devices[self._selected % len(self.devices)] if self.devices else None

    def live(self, device: WatchedDevice) -> bool:
        """Whether the ranges known of `device` are current."""
        return self.connected and device.status.device.state == pb.DEVICE_STATE_STREAMING

    def select(self, index: int) -> None:
        """Selects the device of that index, if there is one."""
        if 0 <= index < len(self.devices):
            self._selected = index
            self.changes += 1

    def step(self, by: int) -> None:
        """Selects the device that many places further, cyclically."""
        if self.devices:
            self.select((self._selected + by) % len(self.devices))
