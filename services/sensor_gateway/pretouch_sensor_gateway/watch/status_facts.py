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


def describe_device(device: WatchedDevice, now: float) -> Iterator[tuple[str, Text]]:
    """Labels and facts: its state, its port, and what it reports of itself."""
    status = device.status
    state = status.device.state
    lasted = timedelta(seconds=max(0, int(now - device.state_since)))
    rate = f" at {status.rate:.1f} Hz" if state == pb.DEVICE_STATE_STREAMING else ""
    opened = "once" if status.connections == 1 else f"{status.connections:,} times"
    yield (
        "state",
        _join_facts(
            Text.assemble((f"● {STATES[state]}{rate}", f"bold {STATE_STYLES[state]}"), f" for {lasted}"),
            f"epoch {status.epoch}",
            f"opened {opened}",
        ),
    )
    if status.device.problem:
        yield "problem", Text(status.device.problem, "bold red")
    yield "port", Text(status.device.port)
    yield "device", _describe_identity(status)


def describe_operation(device: WatchedDevice) -> Iterator[tuple[str, Text]]:
    """Labels and facts: its frames, its clock, its recording."""
    yield "frames", _describe_frames(device.status)
    yield "clock", _describe_clock(device.status)
    yield "record", _describe_recording(device.status.recording)


def _describe_identity(status: pb.GetStatusResponse) -> Text:
    identity = status.identity
    modules = "1 module" if identity.modules == 1 else f"{identity.modules} modules"
    rate = f" at {1 / identity.period:.3g} Hz" if identity.period > 0 else ""
    return _join_facts(
        status.format or "format not recognised yet",
        f"serial {identity.serial}" if identity.serial else "",
        identity.firmware,
        f"{modules}{rate}" if identity.modules else "",
    )


def _describe_frames(status: pb.GetStatusResponse) -> Text:
    refused = {reason: count for reason, count in sorted(status.refused.items()) if count}
    counts = ", ".join(f"{reason} {count:,}" for reason, count in refused.items())
    reasons = counts if len(refused) > 1 else "".join(refused)
    return _join_facts(
        f"{status.device.frames:,} good",
        _format_bad(status.device.lost_frames, "lost"),
        _format_bad(status.device.bad_frames, f"refused ({reasons})" if reasons else "refused"),
        _format_bad(status.untimed, "untimed"),
        _format_bad(status.overrun, "overrun"),
    )


def _describe_clock(status: pb.GetStatusResponse) -> Text:
    clock = status.clock
    jumps = status.host_clock_jumps
    host_jumps = _format_bad(jumps, "host jump" if jumps == 1 else "host jumps") if jumps else ""
    if not clock.synchronised:
        return _join_facts(Text("not synchronised: no ranges are passed on", "yellow"), host_jumps)
    return _join_facts(
        Text("synchronised", "green"),
        f"drift {1e6 * clock.drift:+.1f} ppm",
        Text(f"time ± {1000 * clock.std:.2f} ms", "yellow" if clock.std > _DOUBTFUL_STD else ""),
        f"round trip {1000 * clock.round_trip:.2f} ms" if clock.round_trip > 0 else "answers no pings",
        host_jumps,
    )


def _describe_recording(recording: pb.RecordingStatus) -> Text:
    problem = Text(recording.problem, "bold red")
    if not recording.on:
        return _join_facts("off", f"{_format_bytes(recording.bytes)} on disk" if recording.bytes else "", problem)
    return _join_facts(
        Text("on", "green"),
        problem,
        recording.path,
        _format_bytes(recording.bytes),
        _format_bad(recording.unrecorded, "unrecorded"),
        f"{recording.pending:,} waiting" if recording.pending else "",
    )


def _join_facts(*facts: str | Text) -> Text:
    """The facts that are not empty, side by side."""
    line = Text()
    for fact in facts:
        if fact:
            line.append(" · " if line else "", "dim").append(fact)
    return line


def _format_bad(count: int, what: str) -> Text:
    """A count that should be 0."""
    return Text(f"{count:,} {what}", "yellow" if count else "")


def _format_bytes(count: float) -> str:
    for unit in _UNITS[:-1]:
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} {_UNITS[-1]}"
