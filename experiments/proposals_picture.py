"""Contact sheets of proposals: depth, the object's outline and the first rectangles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from pretouch_simulation.reliability import save_small

from pretouch.rectangle import ProposedRegion
from pretouch.scene import Scene

_COLUMNS = 4
_DEPTH_MARGIN = 0.03
"""m by which the colour scale reaches beyond the object's depths."""


@dataclass(frozen=True, eq=False)
class Proposed:
    """One view and what was proposed on it, the best first."""

    title: str
    scene: Scene
    regions: Sequence[ProposedRegion]


def save_sheet(shown: Sequence[Proposed], title: str, path: Path) -> None:
    """Writes a PNG with a panel for each view."""
    from matplotlib.figure import Figure

    rows = -(-len(shown) // _COLUMNS)
    with mpl.rc_context({"font.size": 8, "axes.titlesize": 8}):
        figure = Figure(figsize=(3.2 * _COLUMNS, 3.0 * rows + 0.4), layout="constrained")
        figure.suptitle(title, fontsize=11, x=0.01, ha="left")
        grid = figure.subplots(rows, _COLUMNS, squeeze=False).ravel()
        for axes in grid:
            axes.axis("off")
        for axes, one in zip(grid, shown, strict=False):
            _draw(axes, one)
        save_small(figure, path, 80)


def _draw(axes: Any, one: Proposed) -> None:
    scene = one.scene
    depth = np.where(scene.depth.metres > 0, scene.depth.metres, np.nan)
    near, far = np.quantile(scene.depth.metres[scene.mask], (0.01, 0.99))
    colours = mpl.colormaps["gray_r"].with_extremes(bad="#202040")
    axes.imshow(depth, cmap=colours, vmin=near - _DEPTH_MARGIN, vmax=far + _DEPTH_MARGIN)
    axes.contour(scene.mask, [0.5], colors="white", linewidths=0.8)
    shades = mpl.colormaps["autumn"](np.linspace(0, 0.85, max(1, len(one.regions))))
    for rank in reversed(range(len(one.regions))):
        corners = one.regions[rank].rectangle.corners()
        axes.plot(*np.concatenate([corners, corners[:1]]).T, color=shades[rank], lw=1.8 if rank == 0 else 1.0)
        spot = {"boxstyle": "circle,pad=0.1", "facecolor": shades[rank], "lw": 0}
        axes.text(*corners[rank % 4], str(rank + 1), fontsize=6, ha="center", va="center", bbox=spot)
    height, width = scene.mask.shape
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    axes.set_title(one.title)
