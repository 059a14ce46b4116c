"""Campaigns of `pretouch evaluate --campaign`, compared over positions and drawn.

    python -m experiments.campaigns NAME=OUT.json ... --picture PICTURE.png

Intervals are of 90 %, by resampling whole campaigns.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pretouch_simulation.campaign_table import KNOWN_FROM
from pretouch_simulation.markdown import markdown_table
from pretouch_simulation.reliability import save_small

from experiments.command_line import run_or_exit
from pretouch.errors import InvalidInput
from pretouch.geometry import Array

_DRAWS = 2000
_MM = 1e3
_ARMS = {"rows": "tab:blue", "rows_without_camera_id": "tab:gray"}
_LABELS = {"rows": "with camera.id", "rows_without_camera_id": "without"}
Statistic = Callable[[Sequence["Session"]], float]


class Session(NamedTuple):
    """How a session of a campaign ended; s and m."""

    campaign: int
    position: int
    seconds: float
    error: float
    covered: bool
    prior_covered: bool
    converged: bool
    knock: bool
    drift: str | None


def main() -> None:
    """Prints a table with a line for each file and arm, and writes the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("outs", nargs="+", metavar="NAME=OUT.json")
    parser.add_argument("--tolerance", type=float, default=0.003)
    parser.add_argument("--picture", type=Path)
    run_or_exit(parser.parse_args(), _run)


def _run(arguments: argparse.Namespace) -> None:
    worlds = {}
    for named in arguments.outs:
        name, _, path = named.partition("=")
        if not path:
            raise InvalidInput(f"{named} names no file.", "Give NAME=OUT.json.")
        worlds[name] = {arm: load_sessions(Path(path), arm) for arm in _ARMS}
    print(_tabulate(worlds, arguments.tolerance))
    if arguments.picture is not None:
        _draw(worlds, arguments.picture)


def load_sessions(path: Path, arm: str) -> list[Session]:
    """The last row of each session in `rows` or `rows_without_camera_id`."""
    last: dict[tuple[int, int], dict[str, Any]] = {}
    for row in json.loads(path.read_text())[arm]:
        last[row["campaign"], row["position"]] = row
    return [
        Session(
            **{name: row[name] for name in ("campaign", "position", "error", "covered", "prior_covered", "knock")},
            seconds=row["robot_seconds"],
            converged=row["state"] == "converged",
            drift=row.get("drift"),
        )
        for row in last.values()
    ]


def bootstrap(sessions: Sequence[Session], statistic: Statistic) -> Array:
    """(3,): the statistic, and the 5 and 95 % quantiles of it over resampled campaigns; NaN where it is undefined."""
    by_campaign: dict[int, list[Session]] = {}
    for session in sessions:
        by_campaign.setdefault(session.campaign, []).append(session)
    groups = list(by_campaign.values())
    rng = np.random.default_rng(0)
    drawn = [
        statistic([one for k in rng.integers(len(groups), size=len(groups)) for one in groups[k]])
        for _ in range(_DRAWS)
    ]
    return np.array([statistic(sessions), *np.nanquantile(drawn, [0.05, 0.95])])


def ratio_of_seconds(sessions: Sequence[Session]) -> float:
    """The median robot seconds from KNOWN_FROM on, as a share of the first objects'."""
    return _median([s for s in sessions if s.position >= KNOWN_FROM]) / _median(
        [s for s in sessions if s.position == 1]
    )


def _median(sessions: Sequence[Session]) -> float:
    return float(np.median([session.seconds for session in sessions])) if sessions else float("nan")


def _mean_error(sessions: Sequence[Session]) -> float:
    return float(np.mean([session.error for session in sessions])) if sessions else float("nan")


def _share_covered(sessions: Sequence[Session]) -> float:
    return float(np.mean([session.covered for session in sessions])) if sessions else float("nan")


def _share_prior_covered(sessions: Sequence[Session]) -> float:
    return float(np.mean([session.prior_covered for session in sessions])) if sessions else float("nan")


def _tabulate(worlds: dict[str, dict[str, list[Session]]], tolerance: float) -> str:
    headings: tuple[str, ...] = (
        "world",
        "camera.id",
        "n",
        "robot s, 1st",
        f"from {KNOWN_FROM}th",
        "ratio",
        "error mm, 1st",
    )
    headings += (f"from {KNOWN_FROM}th", "converged", "of those within", "covered", "prior covered")
    lines = []
    for name, arms in worlds.items():
        for arm, sessions in arms.items():
            if not sessions:
                continue
            first = [s for s in sessions if s.position == 1]
            later = [s for s in sessions if s.position >= KNOWN_FROM]
            converged = [s for s in later if s.converged]
            lines.append(
                (
                    *(name, "yes" if arm == "rows" else "no", f"{len(first)} / {len(later)}"),
                    *(f"{_median(group):.1f}" for group in (first, later)),
                    _interval(bootstrap(sessions, ratio_of_seconds), "{:.2f}"),
                    *(f"{_MM * _mean_error(group):.2f}" for group in (first, later)),
                    f"{len(converged)} of {len(later)}",
                    f"{sum(s.error <= tolerance for s in converged)} of {len(converged)}",
                    _interval(bootstrap(later, _share_covered), "{:.0%}"),
                    _interval(bootstrap(later, _share_prior_covered), "{:.0%}"),
                )
            )
    return markdown_table(headings, lines)


def _interval(values: Array, form: str) -> str:
    value, low, high = (form.format(one) for one in values)
    return f"{value} ({low} to {high})"


def _draw(worlds: dict[str, dict[str, list[Session]]], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 2.7 * len(worlds)), layout="constrained")
    panels = figure.subplots(len(worlds), 2, squeeze=False)
    for (name, arms), (seconds, errors) in zip(worlds.items(), panels, strict=True):
        for arm, sessions in arms.items():
            positions = sorted({session.position for session in sessions})
            if not positions:
                continue
            at = [[s for s in sessions if s.position == k] for k in positions]
            label = f"{_LABELS[arm]}, n = {len(at[0])} to {len(at[-1])}"
            seconds.plot(positions, [_median(group) for group in at], color=_ARMS[arm], label=label)
            errors.plot(positions, [_MM * np.median([s.error for s in group]) for group in at], color=_ARMS[arm])
            for axes, values in ((seconds, [s.seconds for s in sessions]), (errors, [_MM * s.error for s in sessions])):
                axes.plot([s.position for s in sessions], values, ".", color=_ARMS[arm], alpha=0.4)
        seconds.set(title=name, ylabel="robot seconds (line: median)", ylim=(0, None))
        errors.set(title=name, ylabel="error, mm (line: median)", ylim=(0, None))
        seconds.legend(fontsize=8)
    for axes in panels[-1]:
        axes.set_xlabel("object in the campaign")
    for axes in panels.flat:
        axes.grid(alpha=0.3)
    save_small(figure, path, 80)


if __name__ == "__main__":
    main()
