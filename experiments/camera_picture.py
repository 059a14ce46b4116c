"""Real and simulated residuals side by side, and curves that summarise them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pretouch_simulation.reliability import save_small

from experiments.camera_residuals import REACH, SCALES, Residuals
from experiments.camera_scenes import CAMERAS, View, select_camera
from experiments.camera_tables import profile

_SPAN = 8.0
"""mm."""
_MARGIN = 30
_COLOURS = ("black", "tab:green", "tab:red", "tab:blue", "tab:orange")
_MM = 1e3


def save_picture(
    shown: Sequence[Sequence[View]], views: Sequence[tuple[View, Residuals]], title: str, path: Path
) -> None:
    """Writes a PNG: a row of maps for each of `shown`, and below them the curves of `views`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 3.0 * len(shown) + 3.8), layout="constrained")
    figure.suptitle(title, fontsize=10)
    parts = figure.subfigures(2, 1, height_ratios=[3.0 * len(shown), 3.8], squeeze=False)
    top, bottom = parts[:, 0]
    panels = top.subplots(len(shown), len(CAMERAS), squeeze=False)
    for row, seen in zip(panels, shown, strict=True):
        for axes, view in zip(row, seen, strict=True):
            window = _window(view)
            residual = np.where(view.measured > 0, _MM * (view.measured - view.truth.depth), np.nan)[window]
            picture = axes.imshow(residual, cmap="RdBu_r", vmin=-_SPAN, vmax=_SPAN, interpolation="nearest")
            axes.contour(view.mask[window], levels=[0.5], colors="black", linewidths=0.7)
            axes.set_facecolor("0.75")
            axes.set_title(f"{view.camera}: {view.frame}\n{view.name}", fontsize=8)
            axes.set_xticks([])
            axes.set_yticks([])
    top.colorbar(picture, ax=panels, shrink=0.7, label="measured - true, mm; grey: no depth; line: mask")
    levels, ridge, missing = bottom.subplots(1, 3)
    away = np.arange(1, REACH + 1)
    for camera, colour in zip(CAMERAS, _COLOURS, strict=True):
        found = select_camera(views, camera)
        stds = _MM * np.array([[one.std, *one.smoothed] for one in found]).mean(axis=0)
        levels.plot([0.5, *SCALES], stds, "o-", color=colour, label=camera)
        ridge.plot(away, _MM * profile(found, "ridge"), color=colour)
        missing.plot(away, 100 * profile(found, "missing"), color=colour)
    levels.set(xscale="log", ylim=(0, None), xlabel="smoothed over, px (first: not)", ylabel="std of the residual, mm")
    levels.set_xticks([0.5, *SCALES], ["0", *map(str, SCALES)])
    levels.minorticks_off()
    levels.legend(fontsize=8)
    ridge.set(xlabel="from a ridge, px", ylabel="too deep, mm")
    missing.set(xlabel="from a silhouette before a far background, px", ylabel="without depth, %", ylim=(0, 100))
    for axes in (levels, ridge, missing):
        axes.grid(alpha=0.3)
    save_small(figure, path, 80)


def _window(view: View) -> tuple[slice, slice]:
    spans = []
    for axis, length in ((1, view.mask.shape[0]), (0, view.mask.shape[1])):
        there = np.flatnonzero((view.truth.bodies == 0).any(axis=axis))
        spans.append(slice(max(int(there[0]) - _MARGIN, 0), min(int(there[-1]) + _MARGIN, length)))
    return spans[0], spans[1]
