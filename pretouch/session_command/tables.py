"""Sessions and scans as tables, which leave out columns where the terminal is narrow."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from pretouch.session import ScanSummary, Session
from pretouch.session_command.wording import STYLES, clean, describe_returns, reason_name


@dataclass(frozen=True)
class _Column:
    """A column; numbers stand to the right.

    Attributes:
        rank: where the terminal is too narrow for all, those of the highest rank are left out.
        room: characters that it takes at least, whatever is in it: tables below each other are then one.
    """

    title: str
    rank: int
    room: int
    number: bool = True


_GAP = 2
"""Characters between columns."""
_SESSION_COLUMNS = (
    _Column("session", 0, 16, number=False),
    _Column("state", 1, 13, number=False),
    _Column("why", 4, 15, number=False),
    _Column("scans", 3, 5),
    _Column("robot s", 6, 7),
    _Column("expected mm", 5, 11),
    _Column("95 % mm", 2, 7),
    _Column("warnings", 7, 8),
)
_SCAN_COLUMNS = (
    _Column("scan", 0, 8, number=False),
    _Column("path", 3, 9, number=False),
    _Column("samples", 4, 7),
    _Column("returned", 2, 8),
    _Column("path mm", 6, 7),
    _Column("robot s", 5, 7),
    _Column("expected mm", 1, 11),
)


def tabulate_sessions(sessions: Iterable[Session], width: int, *, header: bool) -> Table:
    """The sessions for a terminal of `width` columns; without a header, to go on below others."""
    rows = (
        (
            clean(session.id),
            Text(session.state.value, STYLES[session.state]),
            reason_name(session),
            str(len(session.scans)),
            f"{session.budget_used.seconds:.1f}",
            f"{1000 * session.estimate.expected_error:.1f}",
            f"{1000 * session.estimate.error_quantile:.1f}",
            str(len(session.warnings) or ""),
        )
        for session in sessions
    )
    return _tabulate(_SESSION_COLUMNS, rows, width, header)


def tabulate_scans(scans: Iterable[ScanSummary], width: int) -> Table:
    """The scans for a terminal of `width` columns."""
    rows = (
        (
            clean(scan.scan_id),
            clean(scan.path_id),
            str(scan.samples),
            describe_returns(scan),
            f"{1000 * scan.length:.0f}",
            f"{scan.duration:.1f}",
            f"{1000 * scan.expected_error:.1f}",
        )
        for scan in scans
    )
    return _tabulate(_SCAN_COLUMNS, rows, width)


def _tabulate(
    columns: Sequence[_Column], rows: Iterable[Sequence[str | Text]], width: int, header: bool = True
) -> Table:
    table = Table(show_header=header, box=SIMPLE_HEAD, pad_edge=False, show_edge=False, collapse_padding=True)
    shown = _choose(columns, width)
    for index in shown:
        column = columns[index]
        justify: Literal["left", "right"] = "right" if column.number else "left"
        table.add_column(column.title, justify=justify, min_width=min(column.room, width), overflow="fold")
    for row in rows:
        cells = (row[index] for index in shown)
        table.add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in cells))
    return table


def _choose(columns: Sequence[_Column], width: int) -> list[int]:
    """Indices of the columns that a terminal of `width` columns has room for; at least the most important one."""
    chosen: list[int] = []
    left = width + _GAP
    for index in sorted(range(len(columns)), key=lambda index: columns[index].rank):
        left -= columns[index].room + _GAP
        if chosen and left < 0:
            break
        chosen.append(index)
    return sorted(chosen)
