"""Whether stated uncertainty can be trusted: how often the truth lies in the region of each level, in pictures."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image
from scipy.stats import binom, chi2

from pretouch.geometry import Array
from pretouch_simulation.evaluation_rows import Run
from pretouch_simulation.evaluation_summary import group_by_setup, states_after

LEVELS: Array = np.append(np.arange(1, 20) / 20, 0.99)
"""Nominal probabilities of the regions that are evaluated: 5, 10, ... 95 and 99 %."""
_DIMENSIONS = 6
_BINS = 6
"""Groups of equally many runs whose errors are averaged."""
_COLOURS = ("#1b9e77", "#d95f02", "#7570b3", "#e7298a", "#66a61e")
_CM = 100.0


def compute_observed_shares(distances2: ArrayLike, levels: ArrayLike = LEVELS) -> Array:
    """The share (k,) of `distances2` (n,), chi-square of 6 degrees of freedom if honest, within each level's region."""
    limits = chi2.ppf(np.asarray(levels, dtype=np.float64), _DIMENSIONS)
    return np.asarray((np.asarray(distances2)[:, None] <= limits).mean(axis=0), dtype=np.float64)


def binomial_band(n: int, levels: ArrayLike = LEVELS) -> tuple[Array, Array]:
    """The 95 % limits (k,), (k,) of the shares of a calibrated estimate in `n` independent runs."""
    p = np.asarray(levels, dtype=np.float64)
    return binom.ppf(0.025, n, p) / n, binom.ppf(0.975, n, p) / n


def average_in_bins(expected: ArrayLike, achieved: ArrayLike, bins: int = _BINS) -> tuple[Array, Array]:
    """Means of both, (k,) and (k,), over groups of equally many runs in the order of `expected` (n,)."""
    x, y = np.asarray(expected, dtype=np.float64), np.asarray(achieved, dtype=np.float64)
    groups = [group for group in np.array_split(np.argsort(x, kind="stable"), bins) if len(group)]
    return np.array([x[group].mean() for group in groups]), np.array([y[group].mean() for group in groups])


def save_reliability(runs: Sequence[Run], scans: Sequence[int], title: str, path: Path) -> None:
    """Writes a PNG: nominal against observed coverage, a panel per setup, a line per number of scans."""
    figure, panels = _panels(runs, title)
    for axes, group in panels:
        axes.plot([0, 100], [0, 100], color="black", linewidth=0.8)
        axes.fill_between(
            100 * LEVELS, *(100 * side for side in binomial_band(len(group))), color="0.85", label="95 % of honest ones"
        )
        for scan, colour in zip(scans, _COLOURS, strict=False):
            distances2 = [detail.distance2 for _, detail in states_after(group, scan)]
            if distances2:
                axes.plot(
                    100 * LEVELS,
                    100 * compute_observed_shares(distances2),
                    "o-",
                    ms=3,
                    color=colour,
                    label=_scans(scan),
                )
        axes.set(xlim=(0, 100), ylim=(0, 100), xlabel="nominal, %", ylabel="truth in the region, % of runs")
        axes.set_aspect("equal")
        axes.grid(alpha=0.3)
        axes.legend(loc="lower right", fontsize=8)
    save_small(figure, path, 90)


def save_expected_errors(runs: Sequence[Run], scans: Sequence[int], title: str, path: Path) -> None:
    """Writes a PNG: expected against true error, a dot per run and a line of means, a panel per setup."""
    figure, panels = _panels(runs, title)
    for axes, group in panels:
        axes.plot([0.02, 10], [0.02, 10], color="black", linewidth=0.8)
        for scan, colour in zip(scans, _COLOURS, strict=False):
            rows = [row for row, _ in states_after(group, scan)]
            if rows:
                expected = _CM * np.array([row.expected_error for row in rows])
                achieved = _CM * np.array([row.error for row in rows])
                axes.scatter(expected, achieved, s=6, color=colour, alpha=0.35, linewidths=0)
                axes.plot(
                    *average_in_bins(expected, achieved), "o-", ms=5, color=colour, label=f"{_scans(scan)}, means"
                )
        axes.set(xscale="log", yscale="log", xlim=(0.05, 5), ylim=(0.05, 5))
        ticks = (0.1, 0.2, 0.5, 1, 2, 5)
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
        axes.set(xlabel="expected error, cm", ylabel="true error, cm")
        axes.set_aspect("equal")
        axes.grid(alpha=0.3)
        axes.legend(loc="upper left", fontsize=8)
    save_small(figure, path, 90)


def save_small(figure: Any, path: Path, dpi: int) -> None:
    """Writes a PNG of a figure in 256 colours, a third of the size that it would have; rare colours are kept."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    with Image.open(buffer) as image:
        colours = image.convert("RGB").quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        colours.save(path, optimize=True)


def _panels(runs: Sequence[Run], title: str) -> tuple[Any, list[tuple[Any, list[Run]]]]:
    """A figure with a line of panels per engine and a column per camera and sensor, and the runs of each panel."""
    from matplotlib.figure import Figure

    groups = group_by_setup(runs)
    engines, worlds = (list(dict.fromkeys(names)) for names in zip(*((s.engine, s.world) for s in groups), strict=True))
    size = (4.6 * len(worlds), 0.5 + 4.4 * len(engines))
    figure = Figure(figsize=size, layout="constrained")
    figure.suptitle(title)
    grid = figure.subplots(len(engines), len(worlds), squeeze=False)
    panels = []
    for setup, group in groups.items():
        axes = grid[engines.index(setup.engine), worlds.index(setup.world)]
        axes.set_title(f"{setup.engine}, {setup.camera}, {setup.sensor}, n = {len(group)}")
        panels.append((axes, group))
    return figure, panels


def _scans(count: int) -> str:
    return "1 scan" if count == 1 else f"{count} scans"
