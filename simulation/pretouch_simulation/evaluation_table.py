"""Tables of an evaluation, for a terminal and for Markdown: by scan, by object, honesty and convergence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import TypeVar

import numpy as np
from rich.table import Table as RichTable

from pretouch_simulation.evaluation_convergence import convergence
from pretouch_simulation.evaluation_honesty import Honesty, honesty
from pretouch_simulation.evaluation_rows import Run
from pretouch_simulation.evaluation_summary import Setup, Summary, group_by_setup, summaries, summary_of
from pretouch_simulation.markdown import markdown_table

Line = TypeVar("Line", Summary, Honesty)
_ERRORS = ("mean cm", "median", "std", "p95", "> 1 cm")
_COSTS = ("covered", "expected", "share", "robot s")


@dataclass(frozen=True)
class Table:
    """Cells under their headings; `text` of the columns hold text, the others numbers; `keys` of them name a line."""

    title: str
    headings: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]
    text: int = 1
    keys: int = 1

    def rich(self, width: int) -> list[RichTable]:
        """For a terminal: in as many parts, one below the other, as no column need be cut, each with the keys."""
        parts: list[list[int]] = [[]]
        for column in range(self.keys, len(self.headings)):
            if parts[-1] and self._width([*range(self.keys), *parts[-1], column]) > width:
                parts.append([])
            parts[-1].append(column)
        return [self._part([*range(self.keys), *part], self.title if part is parts[0] else None) for part in parts]

    def _width(self, columns: list[int]) -> int:
        return 1 + sum(3 + max(len(line[k]) for line in (self.headings, *self.lines)) for k in columns)

    def _part(self, columns: list[int], title: str | None) -> RichTable:
        table = RichTable(title=title, title_justify="left")
        for k in columns:
            table.add_column(self.headings[k], justify="left" if k < self.text else "right", no_wrap=True)
        for line in self.lines:
            table.add_row(*(line[k] for k in columns))
        return table

    def to_markdown(self) -> str:
        """Without the title."""
        return markdown_table(self.headings, self.lines)


def tabulate_by_scan(runs: Sequence[Run], scans: Sequence[int]) -> Table:
    """A line for each setup and number of scans, the engines below each other; 0 scans is the error before any.

    A run that stopped counts with its last state in later lines; `made` is how many made the scan, and their time is
    what `ms` counts.
    """
    found = summaries(runs, scans)
    varied, fitted = _find_varied(runs), any(not math.isnan(one.error_fitted) for one in found)
    lines = []
    for one in _side_by_side(found):
        cells = [*_setup_cells(one.setup, varied), str(one.scan), str(one.n), str(one.made), *_errors(one, fitted)]
        lines.append((*cells, *_costs(one), _number(one.compute_p50), _number(one.compute_p95)))
    headings = (*varied, "scan", "n", "made", *_error_headings(fitted), *_COSTS, "ms p50", "ms p95")
    return Table("After each scan", headings, tuple(lines), len(varied), len(varied) + 1)


def tabulate_by_object(runs: Sequence[Run], scans: int) -> Table:
    """One line per object: its errors after the last scan."""
    good = sorted((run for run in runs if run.initial_error is not None), key=lambda run: run.mesh)
    fitted = any(run.frame is not None for run in good)
    lines = []
    for name, group in groupby(good, key=lambda run: run.mesh):
        before, first, last = (summary_of(views, scan) for views in [list(group)] for scan in (0, 1, scans))
        means = (_cm(one.mean) for one in (before, first))
        lines.append((name, str(last.n), *means, *_errors(last, fitted), *_costs(last)))
    headings = ("object", "n", "before", "1 scan", *_error_headings(fitted), *_COSTS)
    return Table(f"By object, after scan {scans}", headings, tuple(lines))


def honesty_table(runs: Sequence[Run], scans: Sequence[int]) -> Table:
    """A line for each setup and number of scans: the share of truths in the stated regions.

    `hardest`: of the quarter of the runs with the largest error. `sure, wrong`: the error is above 1.5 cm while less
    than 0.5 cm is expected.
    """
    varied = _find_varied(runs)
    lines = [
        (
            *_setup_cells(one.setup, varied),
            *(str(one.scan), str(one.n)),
            *(_share(value) for value in (one.within50, one.within80, one.within95)),
            *(_share(value) for value in (one.hard50, one.hard80, one.hard95)),
            *(_cm(one.expected_error), _cm(one.error), _share(one.sure_and_wrong)),
        )
        for one in _side_by_side(honesty(runs, scans))
    ]
    regions = tuple(f"{whom}in {level} %" for whom in ("", "hardest ") for level in (50, 80, 95))
    headings = (*varied, "scan", "n", *regions, "stated cm", "true cm", "sure, wrong")
    return Table("Truth in the stated regions", headings, tuple(lines), len(varied), len(varied) + 1)


def convergence_table(runs: Sequence[Run], tolerance: float) -> Table:
    """A line for each setup: the share that converged, the share of those within `tolerance`, m, and the time taken.

    `with approaches`: the robot's time with APPROACH_SECONDS for each scan. `returns`: median share of the first scan.
    """
    varied = _find_varied(runs)
    lines = [
        (
            *(*_setup_cells(one.setup, varied), str(one.n)),
            *(_share(one.converged), _share(one.within)),
            *(_number(value, 1) for value in (one.seconds_median, one.seconds_p90)),
            *(_number(value, 1) for value in (one.approached_median, one.approached_p90)),
            _share(one.first_returns),
        )
        for one in convergence(runs, tolerance)
    ]
    within = f"within {1000 * tolerance:g} mm" + (" + 2 mm, fitted" if any(run.frame for run in runs) else "")
    times = ("robot s median", "p90", "with approaches median", "p90")
    headings = (*varied, "n", "converged", f"of those {within}", *times, "returns, scan 1")
    return Table("Convergence", headings, tuple(lines), len(varied), len(varied))


def convergence_by_scan_table(runs: Sequence[Run], tolerance: float) -> Table:
    """A line for each setup: the share of the sessions that had converged after 1, 2, ... scans."""
    varied = _find_varied(runs)
    found = convergence(runs, tolerance)
    most = max(len(one.converged_after) for one in found)
    lines = tuple(
        (*_setup_cells(one.setup, varied), str(one.n), *(_share(share) for share in one.converged_after))
        + (_share(one.converged),) * (most - len(one.converged_after))
        for one in found
    )
    headings = (*varied, "n", *(str(scan) for scan in range(1, most + 1)))
    return Table("Converged after so many scans", headings, lines, len(varied), len(varied) + 1)


def _find_varied(runs: Sequence[Run]) -> tuple[str, ...]:
    """The members of the setup that differ between the runs, and are therefore shown."""
    setups = list(group_by_setup(runs))
    return tuple(name for name in ("camera", "sensor", "engine") if len({getattr(one, name) for one in setups}) > 1)


def _side_by_side(found: Sequence[Line]) -> list[Line]:
    """By camera and sensor, then scan, then engine; the state before the first scan once for all engines."""
    worlds = dict.fromkeys(one.setup.world for one in found)
    scans = sorted({one.scan for one in found})
    lines: list[Line] = []
    for world in worlds:
        for scan in scans:
            at = [one for one in found if (one.setup.world, one.scan) == (world, scan)]
            lines += at if scan else at[:1]
    return lines


def _setup_cells(setup: Setup, varied: Sequence[str]) -> list[str]:
    return [getattr(setup, name) for name in varied]


def _error_headings(fitted: bool) -> tuple[str, ...]:
    return (*_ERRORS, *(["fitted"] if fitted else []))


def _errors(one: Summary, fitted: bool) -> list[str]:
    cells = [*(_cm(value) for value in (one.mean, one.median, one.sd, one.p95)), _share(one.large)]
    return [*cells, _cm(one.error_fitted)] if fitted else cells


def _costs(one: Summary) -> list[str]:
    share = "" if math.isnan(one.fraction) else f"{one.fraction:.1%}"
    return [_share(one.covered), _cm(one.expected_error), share, _number(one.robot_seconds, 1)]


def _cm(metres: float) -> str:
    return _number(100 * metres, 2)


def _share(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.0%}"


def _number(value: float, digits: int = 0) -> str:
    return "" if np.isnan(value) else f"{value:.{digits}f}"
