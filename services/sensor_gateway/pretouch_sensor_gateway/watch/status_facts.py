"""A device's status in words: identity, frames, clock, recording."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import timedelta

from rich.text import Text

from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch_sensor_gateway.watch.state import STATES, WatchedDevice

STATE_STYLES = {
    pb.DEVICE_STATE_UNSPECIFIED: "dim",
    pb.DEVICE_STATE_CONNECTING: "yellow",
    pb.DEVICE_STATE_STREAMING: "green",
    pb.DEVICE_STATE_SILENT: "red",
    pb.DEVICE_STATE_ENDED: "blue",
}
_UNITS = ("B", "kB", "MB", "GB", "TB")
_DOUBTFUL_STD = 0.005
"""Seconds; a larger standard deviation of a frame's time is highlighted: at 5 cm/s a quarter of a millimetre."""


def identity_facts(device: WatchedDevice, now: float) -> Iterator[tuple[str, Text]]:
    """Labels and facts: its state, its port, and what it reports of itself."""
    status = device.status
    state = status.device.state
    lasted = timedelta(seconds=max(0, int(now - device.state_since)))
    rate = f" at {status.rate:.1f} Hz" if state == pb.DEVICE_STATE_STREAMING else ""
    opened = "once" if status.connections == 1 else f"{status.connections:,} times"
    yield (
        "state",
        _joined(
            Text.assemble((f"● {STATES[state]}{rate}", f"bold {STATE_STYLES[state]}"), f" for {lasted}"),
            f"epoch {status.epoch}",
            f"opened {opened}",
        ),
    )
    if status.device.problem:
        yield "problem", Text(status.device.problem, "bold red")
    yield "port", Text(status.device.port)
    yield "device", _identity(status)


def running_facts(device: WatchedDevice) -> Iterator[tuple[str, Text]]:
    """Labels and facts: its frames, its clock, its recording."""
    yield "frames", _frames(device.status)
    yield "clock", _clock(device.status)
    yield "record", _recording(device.status.recording)


def _identity(status: pb.GetStatusResponse) -> Text:
    identity = status.identity
    modules = "1 module" if identity.modules == 1 else f"{identity.modules} modules"
    rate = f" at {1 / identity.period:.3g} Hz" if identity.period > 0 else ""
    return _joined(
        status.format or "format not recognised yet",
        f"serial {identity.serial}" if identity.serial else "",
        identity.firmware,
        f"{modules}{rate}" if identity.modules else "",
    )


def _frames(status: pb.GetStatusResponse) -> Text:
    refused = {reason: count for reason, count in sorted(status.refused.items()) if count}
    counts = ", ".join(f"{reason} {count:,}" for reason, count in refused.items())
    reasons = counts if len(refused) > 1 else "".join(refused)
    return _joined(
        f"{status.device.frames:,} good",
        _bad(status.device.lost_frames, "lost"),
        _bad(status.device.bad_frames, f"refused ({reasons})" if reasons else "refused"),
        _bad(status.untimed, "untimed"),
        _bad(status.overrun, "overrun"),
    )


def _clock(status: pb.GetStatusResponse) -> Text:
    clock = status.clock
    jumps = status.host_clock_jumps
    host_jumps = _bad(jumps, "host jump" if jumps == 1 else "host jumps") if jumps else ""
    if not clock.synchronised:
        return _joined(Text("not synchronised: no ranges are passed on", "yellow"), host_jumps)
    return _joined(
        Text("synchronised", "green"),
        f"drift {1e6 * clock.drift:+.1f} ppm",
        Text(f"time ± {1000 * clock.std:.2f} ms", "yellow" if clock.std > _DOUBTFUL_STD else ""),
        f"round trip {1000 * clock.round_trip:.2f} ms" if clock.round_trip > 0 else "answers no pings",
        host_jumps,
    )


def _recording(recording: pb.RecordingStatus) -> Text:
    problem = Text(recording.problem, "bold red")
    if not recording.on:
        return _joined("off", f"{_bytes(recording.bytes)} on disk" if recording.bytes else "", problem)
    return _joined(
        Text("on", "green"),
        problem,
        recording.path,
        _bytes(recording.bytes),
        _bad(recording.unrecorded, "unrecorded"),
        f"{recording.pending:,} waiting" if recording.pending else "",
    )


def _joined(*facts: str | Text) -> Text:
    """The facts that are not empty, side by side."""
    line = Text()
    for fact in facts:
        if fact:
            line.append(" · " if line else "", "dim").append(fact)
    return line


def _bad(count: int, what: str) -> Text:
    """A count that should be 0."""
    return Text(f"{count:,} {what}", "yellow" if count else "")


def _bytes(count: float) -> str:
    for unit in _UNITS[:-1]:
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} {_UNITS[-1]}"
