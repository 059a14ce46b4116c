"""The worst runs in a picture: where the finger scanned, what it hit, and where the estimate puts the object."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from pretouch_orchestrator.sessions.record import Record

from pretouch.geometry import Array, Pose
from pretouch.tof import Scan
from pretouch_simulation.picture import limits, thin_points
from pretouch_simulation.protocol import Case
from pretouch_simulation.reliability import save_small
from pretouch_simulation.worst import Diagnosis, Met, identify_surfaces

_TRUE, _ESTIMATED, _MISS = "#1b7837", "#d95f02", "#377eb8"
_MET = {Met.SEEN: "#1f1f1f", Met.HIDDEN: "#e7298a", Met.BLIND: "#984ea3", Met.TABLE: "#999999"}
_MARGIN = 45
_MOST_POINTS = 1500
_MISS_LENGTH = 0.02
"""m: the length drawn of a beam without a return."""
_CM = 100.0


@dataclass(frozen=True, eq=False)
class Failure:
    """One run after its scans, with its case, its session and what went wrong."""

    title: str
    case: Case
    record: Record
    diagnosis: Diagnosis


def save_worst(failures: Sequence[Failure], title: str, path: Path) -> None:
    """Writes a PNG with one line per run: depth image with the hits, views from above and the side, numbers, reason."""
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 9, "axes.titlesize": 10}):
        figure = Figure(figsize=(17, 4.3 * len(failures)), layout="constrained")
        figure.suptitle(title, fontsize=13, x=0.01, ha="left")
        lines = figure.subfigures(len(failures), 1, squeeze=False)[:, 0]
        for line, failure in zip(lines, failures, strict=True):
            line.suptitle(f"{failure.title}: {failure.diagnosis.reason}", fontsize=11, x=0.01, ha="left", weight="bold")
            depth, above, side, numbers = line.subplots(1, 4, width_ratios=(1.2, 1, 1, 0.9))
            scan = Scan.concatenate(list(failure.record.measured))
            kinds = identify_surfaces(failure.case, scan.points())
            _draw_depth(depth, failure.case, scan, kinds)
            _draw_view(above, failure, scan, kinds, 1, "from above", "base y, cm")
            _draw_view(side, failure, scan, kinds, 2, "from the side", "height, cm")
            side.axhline(0, color="grey", linewidth=0.8)
            numbers.text(0, 1, _numbers(failure), va="top", family="monospace", fontsize=8.5)
            numbers.axis("off")
        handles = above.get_legend_handles_labels()
        figure.legend(*handles, loc="outside upper right", ncols=len(handles[0]), fontsize=8, markerscale=2)
        save_small(figure, path, 65)


def _draw_depth(axes: Any, case: Case, scan: Scan, kinds: NDArray[np.str_]) -> None:
    v, u = np.nonzero(case.mask)
    height, width = case.mask.shape
    u0, v0 = max(u.min() - _MARGIN, 0), max(v.min() - _MARGIN, 0)
    u1, v1 = min(u.max() + _MARGIN, width), min(v.max() + _MARGIN, height)
    depth = case.depth.metres[v0:v1, u0:u1].astype(np.float64)
    depth[depth == 0] = np.nan
    near, far = np.quantile(case.depth.metres[case.mask], (0.01, 0.99))
    edges = (u0 - 0.5, u1 - 0.5, v1 - 0.5, v0 - 0.5)
    axes.imshow(depth, cmap="viridis_r", extent=edges, vmin=near - 0.02, vmax=far + 0.02)
    axes.set_facecolor("black")
    axes.contour(np.arange(u0, u1), np.arange(v0, v1), case.mask[v0:v1, u0:u1], [0.5], colors="white", linewidths=0.8)
    for kind, colour in _MET.items():
        axes.scatter(*_pixels(case, scan.points()[kinds == kind]).T, s=5, color=colour, linewidths=0.2, edgecolors="w")
    axes.scatter(*_pixels(case, _misses(scan)[:, 1]).T, s=9, color=_MISS, marker="x", linewidths=0.7)
    axes.set(xlim=(u0, u1), ylim=(v1, v0), title="depth (black: none), hits and misses", xlabel="u, px", ylabel="v, px")


def _draw_view(
    axes: Any, failure: Failure, scan: Scan, kinds: NDArray[np.str_], axis: int, title: str, label: str
) -> None:
    from matplotlib.collections import LineCollection, PolyCollection

    case, corrected = failure.case, failure.record.estimate.base_T_correction
    body = case.world.bodies[0]
    vertices = body.base_T_mesh.apply(body.mesh.vertices)
    origin = vertices.mean(axis=0) * [1, 1, 0]

    def flat(points: Array) -> Array:
        return np.asarray(((points - origin) * _CM)[..., [0, axis]])

    axes.add_collection(
        PolyCollection(list(flat(vertices[body.mesh.faces])), facecolor="0.88", edgecolor="0.88", lw=0.3)
    )
    clouds = ((case.truth, _TRUE, "the camera's points, truly"), (corrected, _ESTIMATED, "... as estimated"))
    for pose, colour, name in clouds:
        points = flat(thin_points(pose.apply(case.cloud), _MOST_POINTS))
        axes.scatter(*points.T, s=3, color=colour, alpha=0.5, linewidths=0, label=name)
    for kind, colour in _MET.items():
        axes.scatter(*flat(scan.points()[kinds == kind]).T, s=7, color=colour, linewidths=0, label=f"hits {kind.value}")
    misses = flat(_misses(scan))
    axes.add_collection(LineCollection(list(misses), colors=_MISS, linewidths=0.6))
    axes.scatter(*misses[:, 1].T, s=9, color=_MISS, marker="x", linewidths=0.7, label="misses")
    low, high = limits(vertices, [case.truth.apply(case.cloud), corrected.apply(case.cloud)])
    (x0, y0), (x1, y1) = flat(low) - 1.5, flat(high) + 1.5
    axes.set(xlim=(x0, x1), ylim=(y0, y1), xlabel="base x, cm", ylabel=label, title=title)
    axes.set_aspect("equal", adjustable="box")


def _misses(scan: Scan) -> Array:
    """(n, 2, 3), m, in base: a piece of each beam without a return, ending at the mean range of the returns."""
    missed = ~scan.returned
    depth = float(np.median(scan.ranges[scan.returned])) if scan.returned.any() else _MISS_LENGTH
    ends = scan.origins[missed] + depth * scan.directions[missed]
    return np.stack([ends - _MISS_LENGTH * scan.directions[missed], ends], axis=1)


def _pixels(case: Case, points: Array) -> Array:
    """(n, 2): where the camera sees points (n, 3) at their true place in base."""
    base_T_camera: Pose = case.truth @ case.base_T_camera
    return case.camera.project(base_T_camera.inverse().apply(points))


def _numbers(failure: Failure) -> str:
    one = failure.diagnosis
    lines = [
        f"error           {_CM * one.error:6.2f} cm",
        f"expected        {_CM * one.expected_error:6.2f} cm",
        f"d2 (95 %: 12.6) {one.distance2:6.1f}",
        f"beams / returns {one.beams:4d} / {one.returns}",
        *(f"  {kind.value:30s} {_share(count, one.returns)}" for kind, count in one.met.items()),
        f"level surfaces  {one.flat:6.0%} of hits on object",
    ]
    if one.second_distance is not None and one.second_error is not None:
        lines.append(f"second place    {_CM * one.second_distance:6.2f} cm off,")
        lines.append(f"  its error     {_CM * one.second_error:6.2f} cm")
    if one.weakest:
        lines += textwrap.wrap(f"most free: {one.weakest}", 46, subsequent_indent="  ")
    return "\n".join(lines)


def _share(count: int, total: int) -> str:
    return f"{count / total:4.0%}" if total else "   -"
