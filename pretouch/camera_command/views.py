"""Cameras in words, as tables, and as a picture of their error over time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from datetime import UTC, datetime

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from pretouch.calibrated_camera import CalibratedCamera, CameraSummary
from pretouch.geometry import Pose, vector_from_rotation
from pretouch.session_command.wording import clean

_STYLES = {"steady": "green", "suspected": "yellow", "moved": "red"}
_SHOWN = 30
"""Sessions of the picture, the newest."""
_LEAST_BAR, _MOST_BAR, _BESIDE_BAR = 10, 60, 66
"""Characters of the longest bar, and those that the other columns take."""


def tabulate_cameras(cameras: Iterable[CameraSummary]) -> Table:
    table = _table()
    table.add_column("camera", overflow="fold")
    table.add_column("sessions", justify="right")
    table.add_column("drift")
    table.add_column("since session", overflow="fold")
    for camera in cameras:
        drift = Text(camera.drift.state, _STYLES.get(camera.drift.state, ""))
        table.add_row(Text(clean(camera.id)), str(camera.sessions), drift, Text(clean(camera.drift.since or "")))
    return table


def describe(camera: CalibratedCamera) -> Iterator[Text]:
    """What is known of the camera and whether it has moved; a paragraph each."""
    count = f"{camera.sessions} session{'' if camera.sessions == 1 else 's'}"
    if camera.base_T_camera_covariance is None:
        yield Text(f"Camera {clean(camera.id)}: nothing is known of its calibration error yet; {count} counted.")
    else:
        std = np.sqrt(np.diag(camera.base_T_camera_covariance))
        yield Text(
            f"Camera {clean(camera.id)}, after {count}: its error is {_describe_error(camera.camera_T_camera)} on the "
            f"camera's side and {_describe_error(camera.base_T_base)} on the base's. In the next session its pose "
            f"is known to {1000 * std[3:].max():.1f} mm and {np.degrees(std[:3].max()):.2f} deg (standard deviations "
            "along the worst axes)."
        )
    since = clean(camera.drift.since or "")
    if camera.drift.state == "moved":
        yield Text(f"It has moved: session {since} was the first to find it elsewhere.", "bold red")
    elif camera.drift.state == "suspected":
        yield Text(f"It may have moved: session {since} disagrees with those before.", "bold yellow")


def draw_history(camera: CalibratedCamera, width: int) -> Table:
    """A line for each of the newest sessions: a bar of the camera's error; one that found it elsewhere is marked."""
    shown = camera.history[-_SHOWN:]
    most = max((max(each.error, each.expected_error) for each in shown), default=0.0) or 1.0
    room = min(max(width - _BESIDE_BAR, _LEAST_BAR), _MOST_BAR)
    table = _table()
    for title in ("ended (UTC)", "session"):
        table.add_column(title, overflow="fold")
    table.add_column("error mm", justify="right")
    table.add_column("predicted to mm", justify="right")
    table.add_column("")
    for each in shown:
        bar = Text("█" * round(room * each.error / most), "blue")
        if each.session == camera.drift.since:
            bar.append(" ◀", _STYLES.get(camera.drift.state, ""))
        table.add_row(
            _write_time(each.at),
            Text(clean(each.session)),
            f"{1000 * each.error:.1f}",
            f"{1000 * each.expected_error:.1f}",
            bar,
        )
    return table


def tabulate_left_out(camera: CalibratedCamera) -> Table:
    """The sessions that do not count, and why."""
    table = _table()
    for title in ("ended (UTC)", "left out", "why"):
        table.add_column(title, overflow="fold")
    for each in camera.left_out:
        table.add_row(_write_time(each.at), Text(clean(each.session)), Text(clean(each.reason)))
    return table


def _table() -> Table:
    return Table(box=SIMPLE_HEAD, pad_edge=False, show_edge=False)


def _describe_error(side: Pose) -> str:
    shift = 1000 * np.linalg.norm(side.translation)
    return f"{shift:.1f} mm and {np.degrees(np.linalg.norm(vector_from_rotation(side.rotation))):.1f} deg"


def _write_time(at: float) -> str:
    try:
        return datetime.fromtimestamp(at, UTC).strftime("%Y-%m-%d %H:%M")
    except (OverflowError, OSError, ValueError):
        return f"{at:g}"
