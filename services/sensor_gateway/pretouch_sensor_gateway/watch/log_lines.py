"""Lines of text for a log: one for each device and moment."""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import datetime

from pretouch_sensor_gateway.watch.state import STATES, Reading, Watch, WatchedDevice


def log_lines(watch: Watch, wall: float) -> Iterator[str]:
    """A line for each device at Unix time `wall`, s; one for the gateway if it does not answer."""
    time = datetime.fromtimestamp(wall).astimezone().isoformat(timespec="seconds")
    if not watch.connected:
        yield f"{time} {watch.problem or f'Connecting to {watch.address}.'}"
    elif not watch.devices:
        yield f"{time} The gateway at {watch.address} has no device."
    else:
        for device in watch.devices:
            yield f"{time} {_line(device, watch.live(device))}"


def _line(device: WatchedDevice, live: bool) -> str:
    status = device.status
    facts = [f"{device.name} {STATES[status.device.state]}", f"{status.rate:.1f} Hz"]
    if live and device.readings:
        facts.append(" ".join(map(_range, device.readings)) + " mm")
    facts += [
        f"lost {status.device.lost_frames}",
        f"refused {status.device.bad_frames}",
        f"untimed {status.untimed}",
        f"overrun {status.overrun}",
    ]
    if status.clock.synchronised:
        facts.append(f"clock ±{1000 * status.clock.std:.2f} ms")
    if status.recording.on:
        facts.append(f"unrecorded {status.recording.unrecorded}")
    problems = filter(None, (status.device.problem, status.recording.problem))
    return ", ".join(facts) + "".join(f"; {problem}" for problem in problems)


def _range(reading: Reading) -> str:
    """mm; a status code in brackets where there is none."""
    good = reading.code == 0 and not math.isnan(reading.range)
    return f"{1000 * reading.range:.1f}" if good else f"({reading.code})"
