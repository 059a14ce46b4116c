"""The table that the demo shows while its sessions run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from pretouch_simulation.demo import Recording


def live_table(recordings: Sequence[Recording]) -> Table:
    """One line per state of each session; its last line says how it ended. It fits 60 columns."""
    layout: dict[str, Any] = {"box": SIMPLE_HEAD, "show_edge": False, "padding": (0, 1, 0, 0)}
    table = Table(title="Error of the object's points, mm", title_justify="left", **layout)
    for name in ("session", "scan", "path"):
        table.add_column(name, no_wrap=True)
    for name in ("share", "robot s", "expected", "true"):
        table.add_column(name, justify="right", no_wrap=True)
    for recording in recordings:
        columns = (recording.states, recording.robot_seconds(), recording.expected_errors(), recording.true_errors())
        for k, (state, seconds, expected, true) in enumerate(zip(*columns, strict=True)):
            table.add_row(
                recording.title if k == 0 else str(state.state) if state.state.ended else "",
                str(k) if k else "none",
                state.scans[-1].path_id if state.scans else "",
                f"{state.budget_used.fraction:.1%}",
                f"{seconds:.1f}",
                f"{1000 * expected:.1f}",
                f"{1000 * true:.1f}",
            )
        table.add_section()
    return table
