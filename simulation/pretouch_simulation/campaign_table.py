"""Campaigns by position: what a session takes and how good it is, beside the same without `camera.id`."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from pretouch.session import State
from pretouch_simulation.campaign_sessions import CampaignRun
from pretouch_simulation.evaluation_rows import Row
from pretouch_simulation.evaluation_table import Table

KNOWN_FROM = 4
"""The position from which the camera counts as learned."""
_HEADINGS = ("scans", "robot s", "error mm", "converged", "within", "covered")


def last_rows(rows: Sequence[Row]) -> list[Row]:
    """The last row of each session, in the order given; the rows of a session follow each other."""
    return [list(group)[-1] for _, group in groupby(rows, key=lambda row: (row.campaign, row.position, row.view))]


def campaign_table(runs: Sequence[CampaignRun], tolerance: float) -> Table:
    """A line for each setup and position, and one for all from KNOWN_FROM on.

    Medians of robot seconds, means of scans and errors; `within`: share of the converged whose error is within
    `tolerance`, m; `prior`: share of truths in the 95 % region that the session started from. `alone`: without
    `camera.id`.
    """
    setups = dict.fromkeys((run.key.camera, run.key.sensor, run.key.engine) for run in runs)
    varied = [k for k in range(3) if len({setup[k] for setup in setups}) > 1]
    lines = []
    for setup in setups:
        mine = [run for run in runs if (run.key.camera, run.key.sensor, run.key.engine) == setup]
        learned, alone = (
            [row for run in mine if run.key.learns is w for row in last_rows(run.rows)] for w in (True, False)
        )
        positions = sorted({row.position or 0 for row in (*learned, *alone)})
        if not positions:
            continue
        spans = [(str(k), range(k, k + 1)) for k in positions]
        if positions[-1] > KNOWN_FROM:
            spans.append((f"{KNOWN_FROM}-{positions[-1]}", range(KNOWN_FROM, positions[-1] + 1)))
        for name, span in spans:
            one, other = ([row for row in rows if row.position in span] for rows in (learned, alone))
            prior = _share([bool(row.prior_covered) for row in one])
            cells = (*_cells(one, tolerance), prior, *_cells(other, tolerance))
            lines.append((*(setup[k] for k in varied), name, str(len(one)), *cells))
    headings = (*(("camera", "sensor", "engine")[k] for k in varied), "object", "n", *_HEADINGS, "prior")
    alone_headings = tuple(f"alone: {heading}" for heading in _HEADINGS)
    return Table("By position", (*headings, *alone_headings), tuple(lines), len(varied), len(varied) + 1)


def _cells(rows: Sequence[Row], tolerance: float) -> tuple[str, ...]:
    converged = [row for row in rows if row.state == State.CONVERGED]
    return (
        f"{np.mean([row.scan for row in rows]):.1f}" if rows else "",
        f"{np.median([row.robot_seconds for row in rows]):.1f}" if rows else "",
        f"{np.mean([1000 * row.error for row in rows]):.2f}" if rows else "",
        _share([row.state == State.CONVERGED for row in rows]),
        _share([row.error <= tolerance for row in converged]),
        _share([row.covered for row in rows]),
    )


def _share(values: Sequence[bool]) -> str:
    return f"{np.mean(values):.0%}" if values else ""
