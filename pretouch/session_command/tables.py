"""Sessions and scans as tables, which leave out columns where the terminal is narrow."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from pretouch.session import ScanSummary, Session
from pretouch.session_command.wording import STYLES, clean, describe_returns, reason_name


@dataclass(frozen=True)
class _Column:
    """A column that is shown in a terminal of at least `least` columns; numbers stand to the right."""

    title: str
    least: int = 0
    number: bool = True


_SESSION_COLUMNS = (
    _Column("session", number=False),
    _Column("state", number=False),
    _Column("why", 60, number=False),
    _Column("scans", 40),
    _Column("robot s", 80),
    _Column("expected mm", 70),
    _Column("95 % mm", 50),
    _Column("warnings", 90),
)
_SCAN_COLUMNS = (
    _Column("scan", number=False),
    _Column("path", 50, number=False),
    _Column("samples", 60),
    _Column("returned", 40),
    _Column("mm", 70),
    _Column("s", 60),
    _Column("expected mm"),
)


def session_row(session: Session) -> tuple[str | Text, ...]:
    """The cells of `tabulate_sessions` for one session."""
    return (
        clean(session.id),
        Text(session.state.value, STYLES[session.state]),
        reason_name(session),
        str(len(session.scans)),
        f"{session.budget_used.seconds:.1f}",
        f"{1000 * session.estimate.expected_error:.1f}",
        f"{1000 * session.estimate.error_quantile:.1f}",
        str(len(session.warnings) or ""),
    )


def tabulate_sessions(rows: Iterable[Sequence[str | Text]], width: int) -> Table:
    """The rows of `session_row` for a terminal of `width` columns."""
    return _tabulate(_SESSION_COLUMNS, rows, width)


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


def _tabulate(columns: Sequence[_Column], rows: Iterable[Sequence[str | Text]], width: int) -> Table:
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    shown = [index for index, column in enumerate(columns) if column.least <= width]
    for index in shown:
        column = columns[index]
        table.add_column(column.title, justify="right" if column.number else "left", overflow="fold")
    for row in rows:
        cells = (row[index] for index in shown)
        table.add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in cells))
    return table
