"""The picture of `pretouch try`: the object and its regions in the depth image, and the first scan from two sides."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pretouch_orchestrator.sessions.record import Record

from pretouch.camera import DepthImage
from pretouch.geometry import Array
from pretouch_simulation.picture import thin_points

_OBJECT, _AROUND, _PATH = "#d95f02", "#b8b8b8", "#1f1f9f"
_MARGIN = 50
"""px around object and regions that are shown."""
_BESIDE = 0.04
"""m around the path and the object that are shown."""
_LABELLED = 5
_MOST_POINTS = 6000
_CM = 100.0


def save_try_picture(record: Record, depth: DepthImage, path: Path) -> None:
    """Writes a PNG of the session as opened.

    Args:
        depth: the whole image, (h, w).

    Raises:
        OSError: the file cannot be written.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(17, 8), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.35, 1), height_ratios=(1.5, 1))
    _draw_image(figure, figure.add_subplot(grid[:, 0]), record, depth)
    above = figure.add_subplot(grid[0, 1])
    _draw_view(above, record, 1)
    above.set(title="the first scan from above", ylabel="base y, cm")
    beside = figure.add_subplot(grid[1, 1])
    _draw_view(beside, record, 2)
    beside.axhline(0, color="grey", linewidth=0.8)
    beside.set(title="from the side (grey line: the table)", ylabel="height above the table, cm")
    beside.legend(loc="upper center", bbox_to_anchor=(0.5, -0.3), ncols=3, markerscale=3)
    figure.savefig(path, dpi=100)


def _draw_image(figure: Any, axes: Any, record: Record, depth: DepthImage) -> None:
    import matplotlib as mpl

    (u0, v0), step = record.origin, record.step
    mask = np.zeros(depth.metres.shape, dtype=bool)
    seen = record.scene.mask.repeat(step, axis=0).repeat(step, axis=1)
    window = mask[v0 : v0 + len(seen), u0 : u0 + seen.shape[1]]
    window[:] = seen[: len(window), : window.shape[1]]
    near, far = np.quantile(depth.metres[mask], (0.01, 0.99))
    shown = np.where(depth.metres > 0, depth.metres, np.nan)
    axes.imshow(shown, cmap="Greys", vmin=near - 0.08, vmax=far + 0.08)
    axes.set_facecolor("#203040")
    axes.contour(mask, levels=[0.5], colors=_OBJECT, linewidths=1.5)
    errors = 1000 * np.array([region.expected_error for region in record.regions])
    scale = mpl.colors.Normalize(errors.min(), max(errors.max(), errors.min() + 0.1)) if len(errors) else None
    colours = mpl.cm.ScalarMappable(scale, "viridis")
    chosen = record.next_scan.region_id if record.next_scan is not None else ""
    for rank, k in enumerate(np.argsort(errors)):
        region = record.regions[k]
        corners = region.rectangle.corners()
        colour, thick, labelled = colours.to_rgba(errors[k]), region.id == chosen, rank < _LABELLED
        outline = np.concatenate([corners, corners[:1]])
        axes.plot(*outline.T, color=colour, linewidth=3 if thick else 1, alpha=1 if thick or labelled else 0.35)
        if thick or labelled:
            badge = {"boxstyle": "round,pad=0.15", "facecolor": colour, "edgecolor": "black"}
            spot = corners[rank % 4]
            text = axes.text(*spot, f"{errors[k]:.1f}", ha="center", va="center", color="white", bbox=badge)
            text.set_clip_on(True)
    spots = np.stack(np.nonzero(mask)[::-1], axis=1)
    if record.next_scan is not None:
        tips = record.scene.base_T_camera.inverse().apply(record.next_scan.path.base_T_tip[:, :3, 3])
        pixels = record.request.camera.project(tips)
        axes.plot(*pixels.T, ".-", color=_PATH, linewidth=1, markersize=4)
        axes.plot(*pixels[0], "o", color=_PATH, markersize=9)
        spots = np.concatenate([spots, pixels])
    low = np.maximum(spots.min(axis=0) - _MARGIN, 0)
    high = np.minimum(spots.max(axis=0) + _MARGIN, [depth.width - 1, depth.height - 1])
    axes.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), xlabel="u, pixels", ylabel="v, pixels")
    axes.set_title("orange: the object; rectangles: regions, the thick one first; blue: the fingertip, from the dot on")
    if len(errors):
        figure.colorbar(colours, ax=axes, shrink=0.7, label="error expected if this region is scanned first, mm")


def _draw_view(axes: Any, record: Record, up: int) -> None:
    """Draws base x to the right, and base axis `up` upwards."""
    scene, plan = record.scene, record.next_scan
    path: Array = plan.path.base_T_tip[:, :3, 3] if plan is not None else np.zeros((0, 3))
    middle = scene.centroid * [1, 1, 0]
    cloud = thin_points((scene.cloud - middle) * _CM, _MOST_POINTS)
    around = scene.organised[(scene.depth.metres > 0) & ~scene.mask]
    around = thin_points((around - middle) * _CM, _MOST_POINTS)
    path = (path - middle) * _CM
    axes.scatter(around[:, 0], around[:, up], s=2, color=_AROUND, linewidths=0, label="around it")
    axes.scatter(cloud[:, 0], cloud[:, up], s=3, color=_OBJECT, linewidths=0, label="the object")
    axes.plot(path[:, 0], path[:, up], ".-", color=_PATH, linewidth=1, markersize=4, label="the fingertip's path")
    axes.plot(path[:1, 0], path[:1, up], "o", color=_PATH, markersize=9)
    everything = np.concatenate([cloud, path])
    low, high = everything.min(axis=0) - _BESIDE * _CM, everything.max(axis=0) + _BESIDE * _CM
    axes.set_aspect("equal", adjustable="box")
    axes.set(xlim=(low[0], high[0]), ylim=(-2 if up == 2 else low[up], high[up]), xlabel="base x, cm")
