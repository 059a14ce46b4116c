"""One picture of the demo: where the finger scanned, what it hit, and how the error fell."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from pretouch.geometry import Array, Pose
from pretouch_simulation.demo import Recording

BEFORE, AFTER, FINGER, TRUE = "#d95f02", "#1b7837", "#1f1f1f", "#d9d9d9"
_MARGIN = 40
_DEPTH_MARGIN = 0.02
_MOST_POINTS = 3000
_CM = 100.0


def save_picture(recordings: Sequence[Recording], path: Path) -> None:
    """Writes a PNG with one row per session: depth image, clouds before and after, errors."""
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 11, "axes.titlesize": 12}):
        figure = Figure(figsize=(22, 7 * len(recordings)), layout="constrained")
        rows = figure.subfigures(len(recordings), 1, squeeze=False)[:, 0]
        for row, recording in zip(rows, recordings, strict=True):
            row.suptitle(recording.title, fontsize=15, x=0.01, ha="left", fontweight="bold")
            grid = row.add_gridspec(2, 4, width_ratios=(1.25, 1, 1, 1.1), height_ratios=(1.6, 1))
            _draw_depth(row, row.add_subplot(grid[:, 0]), recording)
            first, last = Pose.identity(), recording.last.estimate.base_T_correction
            _draw_clouds(row, grid, 1, recording, first, "before: as the camera puts it", BEFORE)
            _draw_clouds(row, grid, 2, recording, last, "after: as corrected", AFTER)
            _draw_errors(row.add_subplot(grid[:, 3]), recording)
        figure.savefig(path, dpi=100)


def window(recording: Recording) -> tuple[int, int, int, int]:
    """The part (u0, v0, u1, v1) of the depth image around the object and what was scanned."""
    v, u = np.nonzero(recording.case.mask)
    spots = np.concatenate([np.stack([u, v], axis=1), *recording.scanned_pixels()])
    height, width = recording.case.mask.shape
    low = np.maximum(np.floor(spots.min(axis=0)) - _MARGIN, 0).astype(int)
    high = np.minimum(np.ceil(spots.max(axis=0)) + _MARGIN, [width, height]).astype(int)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def depth_range(recording: Recording) -> tuple[float, float]:
    """m: the range of depths around the object that the colours cover."""
    near, far = np.quantile(recording.case.depth.metres[recording.case.mask], (0.01, 0.99))
    return float(near) - _DEPTH_MARGIN, float(far) + _DEPTH_MARGIN


def _draw_depth(row: Any, axes: Any, recording: Recording) -> None:
    u0, v0, u1, v1 = window(recording)
    depth, mask = recording.case.depth.metres[v0:v1, u0:u1].astype(np.float64), recording.case.mask[v0:v1, u0:u1]
    depth[depth == 0] = np.nan
    near, far = depth_range(recording)
    edges = (u0 - 0.5, u1 - 0.5, v1 - 0.5, v0 - 0.5)
    image = axes.imshow(depth, cmap="viridis_r", extent=edges, vmin=near, vmax=far)
    axes.set_facecolor("black")
    row.colorbar(image, ax=axes, label="depth, m (black: no data)", shrink=0.75, extend="both")
    axes.contour(np.arange(u0, u1), np.arange(v0, v1), mask, levels=[0.5], colors="white", linewidths=0.8)
    colours = mpl.colormaps["autumn"](np.linspace(0, 0.85, max(1, len(recording.last.scans))))
    for k, (pixels, colour) in enumerate(zip(recording.scanned_pixels(), colours, strict=False)):
        axes.plot(*pixels.T, ".", color=colour, markersize=4)
        badge = {"boxstyle": "circle,pad=0.2", "facecolor": colour, "edgecolor": "black"}
        for u, v in pixels[:1]:
            axes.text(u, v, str(k + 1), fontweight="bold", ha="center", va="center", fontsize=10, bbox=badge)
    axes.set(xlabel="u, pixels", ylabel="v, pixels", title="depth image, and where the scans' beams ended, in order")
    axes.set_xlim(u0 - 0.5, u1 - 0.5)
    axes.set_ylim(v1 - 0.5, v0 - 0.5)


def _draw_clouds(row: Any, grid: Any, column: int, recording: Recording, pose: Pose, title: str, colour: str) -> None:
    from matplotlib.collections import PolyCollection

    body, corrected = recording.case.world.bodies[0], recording.last.estimate.base_T_correction
    vertices = body.base_T_mesh.apply(body.mesh.vertices)
    origin = vertices.mean(axis=0) * [1, 1, 0]
    triangles = (vertices - origin)[body.mesh.faces] * _CM
    cloud = (thin_points(pose.apply(recording.case.cloud), _MOST_POINTS) - origin) * _CM
    finger = (np.concatenate([np.zeros((0, 3)), *recording.points]) - origin) * _CM
    low, high = limits(vertices, [recording.case.cloud, corrected.apply(recording.case.cloud)])
    low, high = (low - origin) * _CM - 1, (high - origin) * _CM + 1
    for line, axis, name in ((0, 1, "base y, cm"), (1, 2, "height, cm")):
        axes = row.add_subplot(grid[line, column])
        axes.add_collection(PolyCollection(triangles[:, :, [0, axis]], facecolor=TRUE, edgecolor=TRUE, linewidth=0.3))
        axes.scatter(*cloud[:, [0, axis]].T, s=5, color=colour, alpha=0.6, linewidths=0, label="the camera's points")
        axes.scatter(*finger[:, [0, axis]].T, s=6, color=FINGER, linewidths=0, label="the fingertip's points")
        axes.set_aspect("equal", adjustable="box")
        axes.set(xlim=(low[0], high[0]), ylim=(low[axis], high[axis]), xlabel="base x, cm", ylabel=name)
        if line == 0:
            axes.set_title(f"{title}; from above")
        else:
            axes.axhline(0, color="grey", linewidth=0.8)
            axes.set_title("from the side (grey: the true object)")
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.3), ncols=2, markerscale=3, fontsize=10)


def limits(vertices: Array, clouds: Sequence[Array]) -> tuple[Array, Array]:
    """The box (3,), (3,) around the object and all but each cloud's stray points; the same unit as given."""
    spread = [np.quantile(cloud, (0.02, 0.98), axis=0) for cloud in clouds]
    everything = np.concatenate([vertices, *spread])
    return everything.min(axis=0), everything.max(axis=0)


def _draw_errors(axes: Any, recording: Recording) -> None:
    expected = 1000 * np.array(recording.expected_errors())
    true = 1000 * np.array(recording.true_errors())
    scans = np.arange(len(true))
    axes.plot(scans, expected, "o--", color="#7570b3", label="expected by the estimate")
    axes.plot(scans, true, "o-", color=AFTER, label="true")
    for k, value in enumerate(true):
        axes.annotate(f"{value:.1f}", (k, value), textcoords="offset points", xytext=(6, 6), fontsize=10, color=AFTER)
    axes.set_xticks(scans)
    axes.margins(x=0.12)
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.legend()
    fraction, seconds = recording.last.budget_used.fraction, recording.robot_seconds()[-1]
    axes.set(xlabel="scans made", ylabel="mean error of the object's points, mm")
    axes.set_title(f"{recording.last.state}: {fraction:.0%} scanned in {seconds:.0f} robot seconds")


def thin_points(points: Array, most: int) -> Array:
    """About `most` of the points (n, 3) at most, evenly chosen."""
    return points[:: max(1, len(points) // most)]
