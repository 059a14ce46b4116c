"""The tables of one-scan experiments as Markdown; errors in centimetres, the paper's own numbers beside ours."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pretouch_simulation.markdown import markdown_table

from experiments.one_scan import CANDIDATES, PAPER, Row
from experiments.one_scan_figures import Cell, cells, ends, initial, overall
from experiments.oracle import BEST, compute_gap_closed

PAPER_TABLE: dict[str, dict[str, tuple[float, float]]] = {
    name: {"random": random, "narf": narf, "deep": deep}
    for name, random, narf, deep in (
        ("air_freshener", (1.31, 0.52), (2.21, 1.50), (1.26, 0.50)),
        ("clock", (2.21, 1.40), (2.97, 2.16), (0.80, 0.32)),
        ("cleanser", (1.93, 1.46), (0.71, 0.58), (1.16, 0.60)),
        ("controller", (2.77, 1.33), (2.91, 1.96), (1.49, 0.76)),
        ("fruit_bowl", (1.69, 1.50), (1.87, 1.46), (0.83, 0.29)),
        ("gripper", (2.24, 1.39), (1.48, 0.95), (1.11, 0.41)),
        ("toy", (2.55, 1.13), (1.94, 0.66), (1.72, 0.43)),
        ("wallet", (1.16, 0.63), (1.70, 0.83), (0.89, 0.66)),
    )
}
"""cm, mean and standard deviation over an object's first ten proposals: Lancaster et al. 2017, Table 1."""
PAPER_MEAN = {"random": (1.98, 1.14), "narf": (1.97, 1.26), "deep": (1.16, 0.50)}
_TITLES = {
    "ideal": "Real setting, ideal finger: the finger scans the displaced mesh, engine `posterior`",
    "vl6180x": "Real setting, VL6180X: the finger scans the displaced mesh, engine `posterior`",
    "cone": "Real setting, an unknown cone: the finger scans the displaced mesh, engine `posterior`",
    "random": "Real setting, a finger drawn anew for each view scans the displaced mesh, engine `posterior`",
    PAPER: "The paper's own setting: source cut out of the moved cloud, engine `paper`",
}
_HEADINGS = (
    *("proposer", "scans", "mean", "std of scans", "std of proposals", "median", "p95", "> 1 cm", "lowest mean on"),
    *("rectangles a view", "without a path", "of the gain", "of the gain in hindsight"),
)
_NOTES = {
    PAPER: (
        "The error is over all of the object's points; the paper's Algorithm 1 counts those cut out alone. Numbers "
        "compare with the paper's in their order rather than in size. `algorithm 1` is no proposer: it runs 1000 "
        "rectangles x 10 trials on the view itself, which is what labels so made point to.\n",
    )
}
_DASH = "–"


def title_of(setup: str) -> str:
    """What a section about the setup is called."""
    return _TITLES.get(setup, f"Real setting: finger `{setup}` scans the displaced mesh, engine `posterior`")


def section(rows: Sequence[Row], setup: str, missing: dict[str, str]) -> str:
    """The tables of one setup.

    Args:
        rows: all that were made.
        missing: proposers that are not ready, and why.
    """
    rows = [row for row in rows if row.setup == setup]
    lines = [f"## {title_of(setup)}", "", _about(rows), "", *_NOTES.get(setup, ()), _objects(rows, missing)]
    lines += [*_overall(rows), "", *_oracle(rows)]
    lines += [f"`{name}` is left out: {reason}\n" for name, reason in missing.items()]
    lines += [f"Failed: {row.target}, {row.subject}: {row.problem}\n" for row in rows if row.problem]
    return "\n".join(lines)


def _about(rows: Sequence[Row]) -> str:
    proposals = [row for row in rows if row.subject != CANDIDATES]
    targets, objects = {row.target for row in proposals}, {row.object for row in proposals}
    first = proposals[0]
    return (
        f"n = {len(objects)} objects, {len(targets)} views, the first {first.count} proposals of each, {first.offsets} "
        f"hidden offsets each, the same ones for all proposals of a view; seed {first.seed}. Each proposal is scanned "
        f"alone. Error without a scan: {_cm(initial(rows))}. Cells: mean (standard deviation of the single scans over "
        "proposals, views and offsets), and how many proposals there are where some are missing."
    )


def _objects(rows: Sequence[Row], missing: dict[str, str]) -> str:
    table = cells(rows)
    subjects = list(dict.fromkeys(row.subject for row in rows if row.subject != CANDIDATES))
    first = next(row.count for row in rows if row.subject != CANDIDATES)
    known = any(name in PAPER_TABLE for name in table)
    headings = ["object", *subjects, *missing]
    headings += [f"paper: {name}" for name in PAPER_MEAN] if known else []
    lines = []
    for name, by_subject in table.items():
        most = first * len({row.target for row in rows if row.object == name})
        found = [_cell(by_subject[subject], most) for subject in subjects] + [_DASH] * len(missing)
        printed = [_pair(PAPER_TABLE.get(name, {}).get(column)) for column in PAPER_MEAN] if known else []
        lines.append([name, *found, *printed])
    means = [(one.mean, one.std_runs) if (one := overall(rows, subject)) else None for subject in subjects]
    averages = [_DASH if pair is None else _pair((100 * pair[0], 100 * pair[1])) for pair in means]
    averages += [_DASH] * len(missing) + ([_pair(PAPER_MEAN[name]) for name in PAPER_MEAN] if known else [])
    return markdown_table(headings, [*lines, ["**mean**", *averages]])


def _overall(rows: Sequence[Row]) -> list[str]:
    objects = len(cells(rows))
    lines = []
    for subject in dict.fromkeys(row.subject for row in rows if row.subject != CANDIDATES):
        one = overall(rows, subject)
        if one is None:
            lines.append([subject, "0", *[_DASH] * (len(_HEADINGS) - 2)])
            continue
        errors = (one.mean, one.std_runs, one.std_proposals, one.median, one.p95)
        parts = [subject, str(one.runs), *map(_cm, errors), f"{one.large:.0%}", f"{one.best_on} of {objects}"]
        parts += [f"{one.given:.1f}", f"{one.pathless:.0%}", _share(one.gap), _share(one.gap_hindsight)]
        lines.append(parts)
    return [
        markdown_table(_HEADINGS, lines),
        "Standard deviation of proposals: of their errors, each averaged over the offsets. Mean and both deviations "
        "are averaged over the objects, as the paper's last row is.",
    ]


def _oracle(rows: Sequence[Row]) -> list[str]:
    between = ends(rows)
    if between is None:
        return []
    count = next(row.count for row in rows if row.subject == CANDIDATES and row.errors)
    chosen = [("chance: all candidates", between.chance), ("PredictScans' ten best", between.predicted)]
    chosen += [(f"oracle: its {BEST} best", between.oracle), ("in hindsight", between.hindsight)]
    lines = [
        f"What there is to gain: {count} random candidates on each of {between.targets} views, all scanned with the "
        "same offsets. The oracle chooses by every other offset and is judged by the rest, both ways; with few offsets "
        "it chooses by luck too, so that the true best lies between it and hindsight, chosen and judged alike.",
        "",
    ]
    table = [
        [name, _cm(error), _share(compute_gap_closed(between.chance, error, between.oracle))]
        for name, error in chosen
        if not math.isnan(error)
    ]
    return [*lines, markdown_table(["chosen among the candidates", "mean", "of the gain"], table)]


def _cell(found: Cell | None, most: int) -> str:
    """With the number of proposals where there are fewer than `most`."""
    if found is None:
        return _DASH
    few = f", {found.proposals} of {most}" if found.proposals < most else ""
    return _pair((100 * found.mean, 100 * found.std_runs)) + few


def _pair(values: tuple[float, float] | None) -> str:
    return _DASH if values is None else f"{values[0]:.2f} ({values[1]:.2f})"


def _cm(metres: float) -> str:
    return _DASH if math.isnan(metres) else f"{100 * metres:.2f}"


def _share(value: float) -> str:
    return _DASH if math.isnan(value) else f"{value:.0%}"
