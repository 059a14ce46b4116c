"""What an evaluation found, in tables: by scan, by object, and by engine and sensor."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any

import numpy as np
from rich.table import Table

from pretouch.geometry import Array
from pretouch_simulation.evaluation_rows import Row, Run
from pretouch_simulation.evaluation_summary import LARGE, errors_after, summaries


def by_scan(runs: Sequence[Run], scans: int) -> Table:
    """One line per scan over all runs; a run that stopped keeps its last state in later lines."""
    table = _table("After each scan", "scan", "n", "scanned", *_ERRORS, *_COSTS, "ms")
    good = [run for run in runs if run.initial_error is not None]
    if not good:
        return table
    initial = np.array([run.initial_error for run in good], dtype=np.float64)
    table.add_row("none", str(len(good)), "", *_error_cells(initial), "", "", "", "")
    for scan in range(1, scans + 1):
        made = [run.rows[scan - 1] for run in good if len(run.rows) >= scan]
        states = [run.rows[min(scan, len(run.rows)) - 1] for run in good if run.rows]
        table.add_row(
            str(scan),
            str(len(good)),
            str(len(made)),
            *_error_cells(errors_after(good, scan)),
            _mean(states, "covered", "{:.0%}"),
            _mean(states, "fraction", "{:.1%}"),
            _mean(states, "robot_seconds", "{:.1f}"),
            _mean(made, "compute_ms", "{:.0f}"),
        )
    return table


def by_object(runs: Sequence[Run], scans: int) -> Table:
    """One line per object: its errors after the last scan."""
    table = _table(f"By object, after scan {scans}", "object", "n", "before", "1 scan", *_ERRORS, *_COSTS)
    good = sorted((run for run in runs if run.initial_error is not None), key=lambda run: run.mesh)
    for name, group in groupby(good, key=lambda run: run.mesh):
        views = list(group)
        last = [run.rows[-1] for run in views if run.rows]
        initial = np.mean([run.initial_error for run in views if run.initial_error is not None])
        table.add_row(
            name,
            str(len(views)),
            _cm(float(initial)),
            _cm(float(errors_after(views, 1).mean())),
            *_error_cells(errors_after(views, scans)),
            _mean(last, "covered", "{:.0%}"),
            _mean(last, "fraction", "{:.1%}"),
            _mean(last, "robot_seconds", "{:.1f}"),
        )
    return table


def by_engine(runs: Sequence[Run], scans: int) -> Table:
    """One line per engine, sensor and scan."""
    table = _table("By engine", "engine", "sensor", "scan", "n", *_ERRORS, "covered", "expected", *_COSTS[1:], *_TIMES)
    for one in summaries(runs, range(1, scans + 1)):
        table.add_row(
            one.engine,
            one.sensor,
            str(one.scan),
            str(one.n),
            *(_cm(value) for value in (one.mean, one.median, one.sd, one.p95)),
            f"{one.large:.0%}",
            f"{one.covered:.0%}",
            _cm(one.expected_error),
            f"{one.fraction:.1%}",
            f"{one.robot_seconds:.1f}",
            f"{one.compute_p50:.0f}",
            f"{one.compute_p95:.0f}",
        )
    return table


_ERRORS = ("mean cm", "median", "std", "p95", "> 1 cm")
_COSTS = ("covered", "share", "robot s")
_TIMES = ("ms p50", "ms p95")


def _error_cells(errors: Array) -> list[str]:
    return [
        _cm(float(errors.mean())),
        _cm(float(np.median(errors))),
        _cm(float(errors.std())),
        _cm(float(np.quantile(errors, 0.95))),
        f"{(errors > LARGE).mean():.0%}",
    ]


def _cm(metres: float) -> str:
    return f"{100 * metres:.2f}"


def _mean(rows: Sequence[Row], field: str, text: str) -> str:
    values: list[Any] = [getattr(row, field) for row in rows]
    return text.format(float(np.mean(values))) if values else ""


def _table(title: str, first: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column(first, no_wrap=True)
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    return table
