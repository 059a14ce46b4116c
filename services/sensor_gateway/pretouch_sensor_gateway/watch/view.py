"""The screen: the selected device, and the events of all devices."""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import datetime, timedelta

from rich.bar import Bar
from rich.console import Group, RenderableType
from rich.filesize import decimal
from rich.table import Column, Table
from rich.text import Text

from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch_sensor_gateway.range_batch import Flag
from pretouch_sensor_gateway.watch.events import Event
from pretouch_sensor_gateway.watch.state import STATES, Reading, Watch, WatchedDevice

FULL = 0.1
"""Metres of a full bar."""
_EVENTS = 8
_MEANINGS = {
    pb.RANGE_STATUS_UNSPECIFIED: "status",
    pb.RANGE_STATUS_GOOD: "good",
    pb.RANGE_STATUS_NO_TARGET: "no target",
    pb.RANGE_STATUS_REJECTED: "rejected",
    pb.RANGE_STATUS_FAILED: "failed",
    pb.RANGE_STATUS_NO_ANSWER: "no answer",
}
_STYLES = {
    pb.DEVICE_STATE_UNSPECIFIED: "dim",
    pb.DEVICE_STATE_CONNECTING: "yellow",
    pb.DEVICE_STATE_STREAMING: "green",
    pb.DEVICE_STATE_SILENT: "red",
    pb.DEVICE_STATE_ENDED: "blue",
}


def draw(watch: Watch, now: float, wall: float, raw: bool) -> RenderableType:
    """The whole screen at `now`, s of the watch's steady clock, and `wall`, Unix time.

    Args:
        raw: whether the last that the device sent is shown, too.
    """
    parts: list[RenderableType] = [_title(watch, wall)]
    if not watch.connected:
        parts.append(_outage(watch, now))
    elif not watch.devices:
        parts.append(Text("The gateway has no device.", "yellow"))
    device = watch.selected
    if device is not None:
        parts.append(_grid(_facts(device, now, raw)))
        parts.append(_modules(device, watch.live(device)))
    parts.append(_grid((_clock(wall - now + event.at), _event(watch, event)) for event in watch.events.last(_EVENTS)))
    return Group(*parts)


def _title(watch: Watch, wall: float) -> Text:
    title = Text(overflow="ellipsis", no_wrap=True)
    for device in watch.devices:
        title.append(f" {device.name} ", "bold reverse" if device is watch.selected else "")
        title.append("● ", _STYLES[device.status.device.state])
    keys = "   Tab: next device" if len(watch.devices) > 1 else ""
    return title.append(f"gateway {watch.address}  {_clock(wall)}   q: quit   r: raw{keys}", "dim")


def _outage(watch: Watch, now: float) -> Text:
    if not watch.problem:
        return Text("Connecting …", "yellow")
    return Text.assemble((watch.problem, "bold red"), f" Trying again in {max(0, math.ceil(watch.retry_at - now))} s.")


def _facts(device: WatchedDevice, now: float, raw: bool) -> Iterator[tuple[str, Text]]:
    status, clock, recording = device.status, device.status.clock, device.status.recording
    state, identity = status.device.state, status.identity
    lasted = timedelta(seconds=max(0, int(now - device.state_since)))
    head = Text(f"● {STATES[state]} at {status.rate:.1f} Hz", f"bold {_STYLES[state]}")
    yield "state", _join(head, f"for {lasted}", f"epoch {status.epoch}", f"opened {status.connections:,} times")
    if status.device.problem:
        yield "problem", Text(status.device.problem, "bold red")
    yield "port", Text(status.device.port)
    yield (
        "device",
        _join(
            status.format or "format not recognised yet",
            status.unit and f"in {status.unit}",
            identity.serial and f"serial {identity.serial}",
            identity.firmware,
            identity.modules and f"modules {identity.modules}",
            identity.period and f"{1 / identity.period:.3g} Hz",
        ),
    )
    if raw:
        yield "raw", Text("\n".join(status.recent_lines) or "nothing", "cyan")
    yield (
        "frames",
        _join(
            f"{status.device.frames:,} good",
            _bad(status.device.lost_frames, "lost"),
            _bad(status.device.bad_frames, "refused"),
            *(_bad(count, reason) for reason, count in sorted(status.refused.items()) if count),
            _bad(status.untimed, "untimed"),
            _bad(status.overrun, "overrun"),
        ),
    )
    yield (
        "clock",
        _join(
            Text("synchronised", "green") if clock.synchronised else Text("not synchronised: no ranges come", "yellow"),
            clock.synchronised and f"drift {1e6 * clock.drift:+.1f} ppm",
            clock.synchronised and f"time ± {1000 * clock.std:.2f} ms",
            clock.round_trip and f"round trip {1000 * clock.round_trip:.2f} ms",
            status.host_clock_jumps and _bad(status.host_clock_jumps, "jumps of the host's clock"),
        ),
    )
    yield (
        "record",
        _join(
            Text("on", "green") if recording.on else "off",
            Text(recording.problem, "bold red"),
            recording.on and recording.path,
            recording.bytes and f"{decimal(recording.bytes)} on disk",
            recording.on and _bad(recording.unrecorded, "unrecorded"),
        ),
    )


def _modules(device: WatchedDevice, live: bool) -> Table:
    """A line for each module; old ranges are dimmed."""
    table = Table(
        Column("#", justify="right"),
        Column("mm", justify="right", min_width=6),
        Column("status", min_width=6),
        Column(f"0 to {1000 * FULL:.0f} mm", ratio=1),
        Column("returns", justify="right"),
        Column("jumps", justify="right"),
        box=None,
        expand=True,
        header_style="dim",
        style="" if live else "dim",
        show_header=bool(device.readings),
    )
    for k, reading in enumerate(device.readings):
        metres, share = reading.range, device.returns(k)
        table.add_row(
            str(k),
            "-" if math.isnan(metres) else f"{1000 * metres:.1f}",
            _words(reading),
            Bar(FULL, 0, 0 if math.isnan(metres) else min(metres, FULL), color="green" if live else "bright_black"),
            "-" if math.isnan(share) else f"{100 * share:.0f} %",
            f"{device.status.modules[k].jumps:,}" if k < len(device.status.modules) else "-",
        )
    return table


def _words(reading: Reading) -> Text:
    doubts = [flag.name.lower().replace("_", " ") for flag in Flag(reading.flags) if flag.name]
    meaning = _MEANINGS[reading.meaning]
    words = ", ".join([f"{meaning} ({reading.code})" if reading.code else meaning, *doubts])
    return Text(words, "green" if words == "good" else "yellow")


def _event(watch: Watch, event: Event) -> Text:
    device = f"{event.device}: " if event.device and len(watch.devices) > 1 else ""
    return Text(f"{device}{f'{event.amount:,} ' if event.amount else ''}{event.text}", event.severity.value)


def _grid(rows: Iterator[tuple[str, Text]]) -> Table:
    """Labels with a fact beside each, which may take several lines."""
    grid = Table.grid(Column(style="dim", min_width=8, no_wrap=True), Column(overflow="fold"), padding=(0, 1))
    for row in rows:
        grid.add_row(*row)
    return grid


def _join(*facts: str | Text | float) -> Text:
    """The facts that are there, side by side."""
    return Text(" · ").join(fact if isinstance(fact, Text) else Text(str(fact)) for fact in facts if fact)


def _bad(count: int, what: str) -> Text:
    """A count that should be 0."""
    return Text(f"{count:,} {what}", "yellow" if count else "")


def _clock(wall: float) -> str:
    return datetime.fromtimestamp(wall).strftime("%H:%M:%S")
