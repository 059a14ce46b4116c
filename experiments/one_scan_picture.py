"""One-scan experiments in a picture: each object's mean error by proposer, between chance and oracle."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pretouch_simulation.reliability import save_small

from experiments.one_scan import ALGORITHM_1, CANDIDATES, PAPER, Row
from experiments.one_scan_figures import cells, ends
from experiments.one_scan_text import PAPER_MEAN, PAPER_TABLE, title_of

COLOURS = {"random": "#999999", "narf": "#e6a000", "stability": "#377eb8", "deep": "#1b7837", ALGORITHM_1: "#984ea3"}
_WIDTH = 0.8


def save(rows: Sequence[Row], path: Path) -> None:
    """Writes a PNG with a panel for each setup."""
    from matplotlib.figure import Figure

    setups = list(dict.fromkeys(row.setup for row in rows))
    objects = len({row.object for row in rows})
    figure = Figure(figsize=(max(9.0, 3.5 + 1.15 * (objects + 1)), 4.3 * len(setups)), layout="constrained")
    for axes, setup in zip(figure.subplots(len(setups), 1, squeeze=False)[:, 0], setups, strict=True):
        _draw(axes, [row for row in rows if row.setup == setup], setup)
    save_small(figure, path, 90)


def _draw(axes: Any, rows: Sequence[Row], setup: str) -> None:
    table = cells(rows)
    subjects = list(dict.fromkeys(row.subject for row in rows if row.subject != CANDIDATES))
    names = [*table, "mean"]
    step = _WIDTH / len(subjects)
    for k, subject in enumerate(subjects):
        found = [one for by_subject in table.values() if (one := by_subject[subject]) is not None]
        means = [100 * (one.mean if (one := table[name][subject]) else np.nan) for name in table]
        spreads = [100 * (one.std_runs if (one := table[name][subject]) else np.nan) for name in table]
        if found:
            means.append(100 * float(np.mean([one.mean for one in found])))
            spreads.append(100 * float(np.mean([one.std_runs for one in found])))
        x = np.arange(len(means)) + (k + 0.5) * step - _WIDTH / 2
        below = np.minimum(spreads, means)
        axes.bar(x, means, 0.9 * step, color=COLOURS[subject], label=subject)
        axes.errorbar(x, means, [below, spreads], fmt="none", ecolor="black", elinewidth=0.8, capsize=2)
    _draw_limits(axes, rows, list(table))
    if setup == PAPER:
        _draw_printed(axes, list(table), subjects, step)
    first = next(row for row in rows if row.subject != CANDIDATES)
    views = len({row.target for row in rows})
    counts = f"{len(table)} objects, n = {views} views x {first.count} proposals x {first.offsets} offsets"
    title = title_of(setup).replace("`", "")
    axes.set_title(f"{title}\nmean and standard deviation of one scan: {counts}, seed {first.seed}", fontsize=10)
    axes.set_xticks(range(len(names)), [name.replace("__", "\n").replace("_", " ") for name in names], fontsize=8)
    axes.set(ylabel="error of the object's points, cm", xlim=(-0.6, len(names) - 0.4))
    axes.set_ylim(bottom=0)
    axes.grid(axis="y", alpha=0.3)
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _draw_limits(axes: Any, rows: Sequence[Row], names: Sequence[str]) -> None:
    """Chance and oracle of each object, and of all."""
    groups = [[row for row in rows if row.object == name] for name in names]
    marks = (("chance", "--", "all candidates"), ("oracle", "-", "oracle"))
    found = [ends(group) for group in [*groups, rows]]
    for attribute, style, label in marks:
        for k, between in enumerate(found):
            if between is not None:
                level = 100 * getattr(between, attribute)
                axes.plot([k - 0.45, k + 0.45], [level, level], style, color="black", lw=1.3, label=label)
                label = ""


def _draw_printed(axes: Any, names: Sequence[str], subjects: Sequence[str], step: float) -> None:
    """The paper's own means, where its table has the object and the proposer."""
    label = "the paper's own number"
    for k, name in enumerate([*names, "mean"]):
        printed = PAPER_MEAN if name == "mean" else PAPER_TABLE.get(name, {})
        if name == "mean" and not any(other in PAPER_TABLE for other in names):
            continue
        for j, subject in enumerate(subjects):
            if subject in printed:
                x = k + (j + 0.5) * step - _WIDTH / 2
                axes.plot([x], [printed[subject][0]], "D", ms=5, mfc="white", mec="black", label=label)
                label = ""
