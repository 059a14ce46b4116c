"""The state of a gateway and its devices, updated from its messages. Times are s of one steady clock."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import array_from_proto
from pretouch_sensor_gateway.watch.events import EventLog, Severity

STATES = {
    pb.DEVICE_STATE_UNSPECIFIED: "unknown",
    pb.DEVICE_STATE_CONNECTING: "connecting",
    pb.DEVICE_STATE_STREAMING: "streaming",
    pb.DEVICE_STATE_SILENT: "silent",
    pb.DEVICE_STATE_ENDED: "ended",
}
RECENT = 300
"""Measurements over which the share of returns is computed: 10 s at 30 Hz."""
_SEVERITIES = {pb.DEVICE_STATE_STREAMING: Severity.GOOD, pb.DEVICE_STATE_SILENT: Severity.BAD}


class Reading(NamedTuple):
    """A module's newest measurement.

    Attributes:
        range: m along its beam, NaN for none.
        code: the sensor's own status code.
        meaning: of that code; unspecified in old recordings.
        flags: as in RangeBatch.
    """

    range: float
    code: int
    meaning: pb.RangeStatus.ValueType
    flags: int


class WatchedDevice:
    """One device.

    Attributes:
        status: the last that the gateway sent.
        state_since: since when it has been in its state, as far as it was watched.
    """

    def __init__(self, device: pb.Device, events: EventLog, at: float) -> None:
        self.name = device.name
        self.status = pb.GetStatusResponse(device=device)
        self.state_since = at
        self._events = events
        self._last: list[Reading] = []
        self._recent: deque[list[bool]] = deque(maxlen=RECENT)  # which modules had a range
        self._known = False  # whether `status` continues the one before
        self._noted_state = pb.DEVICE_STATE_UNSPECIFIED

    def take_status(self, status: pb.GetStatusResponse, at: float) -> None:
        """Takes a status of the device, and notes what happened since the one before."""
        before, self.status = self.status, status
        if status.device.state != self._noted_state:
            self._note_state(at)
        elif status.device.problem and status.device.problem != before.device.problem:
            self._note(status.device.problem, Severity.BAD, at)
        if self._known:
            self._note_changes(before, at)
        self._known = True

    def take_ranges(self, response: pb.StreamRangesResponse) -> None:
        """Takes measurements of the device.

        Raises:
            InvalidInput: an array is not of its stated shape and type.
        """
        batch = response.batch
        ranges, code, flags = (array_from_proto(getattr(batch, name), name) for name in ("range", "status", "flags"))
        told = batch.HasField("range_status")  # an old recording does not tell
        meaning = array_from_proto(batch.range_status, "range_status") if told else np.zeros_like(code)
        if len(ranges):
            rows = (column[-1].tolist() for column in (ranges, code, meaning, flags))
            self._last = [Reading(*values) for values in zip(*rows, strict=True)]
            self._recent.extend((np.isfinite(ranges) & (code == 0)).tolist())

    @property
    def readings(self) -> list[Reading]:
        """Each module's newest measurement: from the stream, or from the status if none was streamed yet."""
        return self._last or [Reading(one.range, one.status, one.range_status, 0) for one in self.status.modules]

    def returns(self, module: int) -> float:
        """Share of the last `RECENT` measurements in which the module had a range; NaN before the first."""
        found = [row[module] for row in self._recent if module < len(row)]
        return sum(found) / len(found) if found else math.nan

    def forget_counts(self) -> None:
        """Forgets all counts: the gateway was away and may have restarted, so new counts do not continue old ones."""
        self._known = False

    def _note_state(self, at: float) -> None:
        device = self.status.device
        self._noted_state, self.state_since = device.state, at
        text = f"{STATES[device.state]}: {device.problem}" if device.problem else STATES[device.state]
        self._note(text, _SEVERITIES.get(device.state, Severity.NOTE), at)

    def _note_changes(self, before: pb.GetStatusResponse, at: float) -> None:
        now = self.status
        if now.epoch > before.epoch:
            self._note(f"restarted: epoch {now.epoch}", Severity.NOTE, at)
        for what, count in (_counts(now) - _counts(before)).items():
            self._note(what, Severity.BAD, at, count)
        if now.clock.synchronised != before.clock.synchronised:
            known = now.clock.synchronised
            self._note(f"its clock is {'' if known else 'not '}known", Severity.GOOD if known else Severity.BAD, at)
        if now.recording.on and now.recording.path and now.recording.path != before.recording.path:
            self._note(f"recording to {now.recording.path}", Severity.NOTE, at)
        if before.recording.on and not now.recording.on:
            self._note("recording stopped", Severity.NOTE, at)
        if now.recording.problem and now.recording.problem != before.recording.problem:
            self._note(f"recording: {now.recording.problem}", Severity.BAD, at)

    def _note(self, text: str, severity: Severity, at: float, amount: int = 0) -> None:
        self._events.add(self.name, text, severity, at, amount)


def _counts(status: pb.GetStatusResponse) -> Counter[str]:
    """What should not happen, by the words for it."""
    counts = Counter(
        {
            "lost": status.device.lost_frames,
            "given up: their time was not known": status.untimed,
            "lost to slow subscribers": status.overrun,
            "jumps of the host's clock": status.host_clock_jumps,
        }
    )
    return counts + Counter({f"refused: {reason}": count for reason, count in status.refused.items()})


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

    def select_next(self) -> None:
        """Selects the next device, cyclically."""
        self._selected += 1
        self.changes += 1
