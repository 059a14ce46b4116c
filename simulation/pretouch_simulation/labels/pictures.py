"""A dataset in two pictures: its statistics, and a contact sheet of views."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from pretouch_detector.training.dataset import SIDES, Dataset, Example, read

from pretouch.geometry import Array
from pretouch.rectangle import RotatedRectangle
from pretouch_simulation.labels.statistics import ViewStatistics
from pretouch_simulation.reliability import save_small
from pretouch_simulation.split import compute_mixing_key

_COLOURS = {"train": "#1b9e77", "validation": "#d95f02"}
_BEST, _WORST = "#00d000", "#ff2020"
_COLUMNS = 8
_MOST_CM = 4.0
_SHARES = (0.0, 0.1, 0.3, 1.0)
_DEPTH_MARGIN = 0.02
"""m by which the colour scale reaches beyond the object's depths."""
_CM = 100.0


def save_statistics(views: Sequence[ViewStatistics], title: str, path: Path) -> None:
    """Writes a PNG: objects and views, errors of rectangles, best and median of views, what cannot be scanned."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 8), layout="constrained")
    figure.suptitle(title)
    counts, errors, views_axes, unscannable = figure.subplots(2, 2).ravel()
    sides = [side for side in SIDES if any(view.side == side for view in views)]
    by_side = {side: [view for view in views if view.side == side] for side in sides}
    _draw_counts(counts, by_side)
    _draw_errors(errors, by_side)
    _draw_views(views_axes, by_side)
    _draw_unscannable(unscannable, by_side)
    save_small(figure, path, 80)


def save_contact_sheet(dataset: Dataset, path: Path, rows: int = 6) -> list[str]:
    """Writes a PNG of up to `rows` x 8 views of as many objects as there are; their names.

    Each with the object's outline (white), the best rectangle (green) and the worst one (red).
    """
    from matplotlib.figure import Figure

    shown = _chosen(dataset)[: rows * _COLUMNS]
    rows = -(-len(shown) // _COLUMNS)
    with mpl.rc_context({"font.size": 7}):
        figure = Figure(figsize=(1.75 * _COLUMNS, 0.4 + 1.9 * rows), layout="constrained")
        meant = "of the worst trial" if dataset.by_worst else "after the scan"
        figure.suptitle(f"best rectangle green, worst red; errors {meant}", fontsize=10)
        grid = figure.subplots(rows, _COLUMNS, squeeze=False).ravel()
        for axes in grid:
            axes.axis("off")
        for axes, (side, file) in zip(grid, shown, strict=False):
            _draw_view(axes, read(file), side, dataset.by_worst)
        save_small(figure, path, 90)
    return [file.stem for _, file in shown]


def _chosen(dataset: Dataset) -> list[tuple[str, Path]]:
    """Side and file, in an order fixed by the names: every object comes once before any comes again."""
    files = [(side, file) for side in SIDES for file in dataset.list_paths(side)]
    seen: dict[str, int] = {}
    order = []
    for side, file in sorted(files, key=lambda one: compute_mixing_key(one[1].stem)):
        thing = file.stem.partition("-")[0]
        seen[thing] = seen.get(thing, 0) + 1
        order.append((seen[thing], side, file))
    return [(side, file) for _, side, file in sorted(order, key=lambda one: one[0])]


def _draw_counts(axes: Any, by_side: dict[str, list[ViewStatistics]]) -> None:
    for k, (side, views) in enumerate(by_side.items()):
        values = (len({view.object for view in views}), len(views))
        bars = axes.bar(np.arange(2) + 0.4 * k - 0.2, values, 0.38, color=_COLOURS[side], label=side)
        axes.bar_label(bars, fmt="%.0f")
    axes.set_xticks(np.arange(2), ("objects", "views"))
    axes.margins(y=0.12)
    axes.legend()
    axes.set_title("what there is")


def _draw_errors(axes: Any, by_side: dict[str, list[ViewStatistics]]) -> None:
    bins = np.linspace(0, _MOST_CM, 41)
    for side, views in by_side.items():
        errors = np.concatenate([view.errors for view in views])
        cm = np.minimum(_CM * errors, _MOST_CM)
        weights = np.full(len(cm), 100.0 / max(1, len(cm)))
        label = f"{side}, n = {len(cm)}"
        axes.hist(cm, bins, weights=weights, histtype="step", linewidth=1.6, color=_COLOURS[side], label=label)
    axes.set(xlabel=f"error, cm (last bin: {_MOST_CM:g} or more)", ylabel="% of rectangles")
    axes.set_title("rectangles with trials")
    axes.legend()


def _draw_views(axes: Any, by_side: dict[str, list[ViewStatistics]]) -> None:
    for side, views in by_side.items():
        scored = [view for view in views if len(view.errors)]
        share = 100.0 * np.arange(len(scored) + 1) / max(1, len(scored))
        for values, style, name in (
            ([view.best for view in scored], "-", "best"),
            ([view.median for view in scored], "--", "median"),
        ):
            axes.step(
                _CM * np.sort([0.0, *values]),
                share,
                style,
                where="post",
                color=_COLOURS[side],
                label=f"{side}: {name} rectangle",
            )
    axes.set(xlabel="error, cm", ylabel="% of views at or below", xlim=(0, _MOST_CM), ylim=(0, 100))
    axes.set_title("views")
    axes.grid(alpha=0.3)
    axes.legend()


def _draw_unscannable(axes: Any, by_side: dict[str, list[ViewStatistics]]) -> None:
    axes.set_title("rectangles that cannot be scanned")
    names = ["none", *(f"{low:.0%} to {high:.0%}" for low, high in pairwise(_SHARES))]
    determined = False
    for k, (side, views) in enumerate(by_side.items()):
        shares: Array = np.array([view.unscannable for view in views if not np.isnan(view.unscannable)])
        if not len(shares):
            continue
        determined = True
        groups = np.bincount(np.searchsorted(_SHARES, shares), minlength=len(names))
        label = f"{side}: {shares.mean():.1%} of all"
        place = np.arange(len(names)) + 0.4 * k - 0.2
        bars = axes.bar(place, 100.0 * groups / len(shares), 0.38, color=_COLOURS[side], label=label)
        axes.bar_label(bars, fmt="%.0f", fontsize=7)
    if not determined:
        axes.text(0.5, 0.5, "Not determined for Algorithm 1.", ha="center", va="center", transform=axes.transAxes)
        axes.axis("off")
        return
    axes.set_xticks(np.arange(len(names)), names, fontsize=8)
    axes.set(xlabel="share of a view's rectangles", ylabel="% of views")
    axes.legend()


def _draw_view(axes: Any, example: Example, side: str, worst: bool) -> None:
    scene, errors = example.scene, example.compute_errors(worst)
    depth = scene.depth.metres.astype(np.float64)
    near, far = np.quantile(depth[scene.mask], (0.01, 0.99))
    depth[depth == 0] = np.nan
    image = mpl.colormaps["viridis_r"].with_extremes(bad="black")
    axes.imshow(depth, cmap=image, vmin=near - _DEPTH_MARGIN, vmax=far + _DEPTH_MARGIN)
    axes.contour(scene.mask, levels=[0.5], colors="white", linewidths=0.8)
    text = f"{example.name}\n{side}"
    if not np.isnan(errors).all():
        ends = {int(np.nanargmax(errors)): _WORST, int(np.nanargmin(errors)): _BEST}
        for k, colour in ends.items():
            corners = RotatedRectangle(*example.rectangles[k]).corners()
            axes.plot(*np.concatenate([corners, corners[:1]]).T, color=colour, linewidth=1.4)
        text += f", {_CM * np.nanmin(errors):.2f} to {_CM * np.nanmax(errors):.2f} cm"
    axes.set(xlim=(-0.5, depth.shape[1] - 0.5), ylim=(depth.shape[0] - 0.5, -0.5))
    axes.set_title(text, fontsize=6, pad=2)
