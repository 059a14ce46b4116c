"""Sequences of scans in pictures: the error's fall, and the clouds with the scans that moved them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from pretouch_simulation.evaluation import Step
from pretouch_simulation.picture import limits, thin_points
from pretouch_simulation.protocol import Case
from pretouch_simulation.reliability import save_small

from experiments.one_scan_picture import COLOURS
from experiments.sessions import Course, errors_at, means_after_scan
from pretouch.geometry import Array, Pose
from pretouch.tof import Scan

_SHOWN = (0, 1, 2, 3, 5)
"""After how many scans the clouds are drawn."""
_MOST_POINTS = 2500
_CM = 100.0


def save_curves(courses: Sequence[Course], scans: int, title: str, path: Path) -> None:
    """Writes a PNG: mean error against the share of the object scanned, a panel for each planner."""
    from matplotlib.figure import Figure

    planners = list(dict.fromkeys(course.planner for course in courses))
    figure = Figure(figsize=(6.2 * len(planners), 4.8), layout="constrained")
    figure.suptitle(f"{title}; dots: means after 1, 2, ... scans; thin: mean at each share", fontsize=10)
    panels = figure.subplots(1, len(planners), squeeze=False, sharey=True)[0]
    furthest = max(means_after_scan([course], scans)[0] for course in courses)
    for axes, planner in zip(panels, planners, strict=True):
        for proposer in dict.fromkeys(course.proposer for course in courses):
            group = [course for course in courses if (course.proposer, course.planner) == (proposer, planner)]
            if not group:
                continue
            shares = np.linspace(0.0, min(furthest, 0.5), 251)
            curve = _CM * errors_at(group, shares).mean(axis=0)
            axes.plot(100 * shares, curve, color=COLOURS[proposer], lw=1.0, alpha=0.5)
            marks = np.array([means_after_scan(group, scan) for scan in range(scans + 1)])
            label = f"{proposer}, n = {len(group)}"
            axes.plot(100 * marks[:, 0], _CM * marks[:, 1], "o-", color=COLOURS[proposer], ms=4, lw=1.6, label=label)
        for level in (0.5, 0.2):
            axes.axhline(level, color="black", lw=0.7, ls=":")
        axes.set(xlabel="share of the object scanned, %", yscale="log", xlim=(0, 100 * min(furthest, 0.5)))
        axes.set_yticks([0.05, 0.1, 0.2, 0.5, 1, 2], ["0.05", "0.1", "0.2", "0.5", "1", "2"])
        axes.minorticks_off()
        axes.set_ylim(0.04, 3)
        axes.set_title(f"order of the scans: {planner}")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=9)
    panels[0].set_ylabel("mean error of the object's points, cm")
    save_small(figure, path, 95)


def save_clouds(sessions: Sequence[tuple[str, Case, Sequence[Step]]], title: str, path: Path) -> None:
    """Writes a PNG: each session from above and from the side, before and after some of its scans."""
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 8, "axes.titlesize": 9}):
        most = max(len(steps) for _, _, steps in sessions)
        shown = [scans for scans in _SHOWN if scans <= most]
        figure = Figure(figsize=(2.5 * len(shown) + 0.3, 4.6 * len(sessions) + 0.4), layout="constrained")
        figure.suptitle(title, fontsize=11, x=0.01, ha="left")
        parts = figure.subfigures(len(sessions), 1, squeeze=False)[:, 0]
        for part, (name, case, steps) in zip(parts, sessions, strict=True):
            part.suptitle(name, x=0.01, ha="left", weight="bold", fontsize=10)
            panels = part.subplots(2, len(shown), height_ratios=(1.4, 1))
            for column, scans in enumerate(shown):
                _draw_state(panels[:, column], case, steps[: min(scans, len(steps))])
            for axes, label in zip(panels[:, 0], ("from above, cm", "from the side, cm"), strict=True):
                axes.set_ylabel(label)
        handles = panels[0, 0].get_legend_handles_labels()
        figure.legend(*handles, loc="outside upper right", ncols=2, fontsize=8, markerscale=4)
        save_small(figure, path, 75)


def _draw_state(panels: Any, case: Case, made: Sequence[Step]) -> None:
    from matplotlib.collections import PolyCollection

    pose = made[-1].record.estimate.base_T_correction if made else Pose.identity()
    scan = Scan.concatenate(list(made[-1].record.measured) if made else [])
    body = case.world.bodies[0]
    vertices = body.base_T_mesh.apply(body.mesh.vertices)
    origin = vertices.mean(axis=0) * [1, 1, 0]
    cloud = thin_points(pose.apply(case.cloud), _MOST_POINTS)
    low, high = limits(vertices, [case.cloud, case.truth.apply(case.cloud)])
    for axes, axis in zip(panels, (1, 2), strict=True):

        def flat(points: Array, axis: int = axis) -> Array:
            return np.asarray((_CM * (points - origin))[..., [0, axis]])

        triangles = list(flat(vertices[body.mesh.faces]))
        axes.add_collection(PolyCollection(triangles, facecolor="0.85", edgecolor="0.85", lw=0.3))
        axes.scatter(*flat(cloud).T, s=2, color="#d95f02", alpha=0.5, linewidths=0, label="camera's points")
        axes.scatter(*flat(scan.points()).T, s=4, color="#1f1f1f", linewidths=0, label="fingertip's points")
        (x0, y0), (x1, y1) = flat(low) - 1, flat(high) + 1
        axes.set(xlim=(x0, x1), ylim=(y0, y1))
        axes.set_aspect("equal", adjustable="box")
    share = made[-1].record.budget_used.fraction if made else 0.0
    error = _CM * case.error(pose)
    panels[0].set_title(f"{len(made)} scans, {share:.0%} scanned: {error:.2f} cm")
    panels[1].axhline(0, color="grey", lw=0.8)
