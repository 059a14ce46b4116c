"""Simulated fingertips in a picture: curves and drift beside real modules', and scans of an edge and a bar."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pretouch_simulation.finger import Finger, FingerModel, measure_scan, realise
from pretouch_simulation.objects import box
from pretouch_simulation.protocol import TABLE, generator
from pretouch_simulation.reliability import save_small
from pretouch_simulation.world import Body, World

from pretouch.geometry import Array, Pose

HEIGHT = 0.03
"""m, of the step and of the bar."""
BAR = 0.02
"""m, its width."""
TIP = 0.065
"""m above the table."""
_SPAN = 0.05
_SCANS = 25
_MM = 1000.0


def face_down(x: Array, z: Array) -> Array:
    """Poses (n, 4, 4) of a module at (x, 0, z), m, its beam straight down."""
    poses = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (len(x), 1, 1))
    poses[:, 0, 3], poses[:, 2, 3] = x, z
    return poses


def save_picture(
    curves: Mapping[str, tuple[Array, Array]],
    wander: Mapping[str, tuple[Sequence[float], Array]],
    draws: Sequence[Finger],
    path: Path,
) -> None:
    """Writes a PNG.

    Args:
        curves: by module, distances (d,) and errors (f, d), m.
        wander: by module, averaging times (s,) in s and standard deviations between means (s,), m.
        draws: random fingers to show.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.0, 9.0), layout="constrained")
    panels = figure.subplots(2, 2)
    _draw_curves(panels[0, 0], curves)
    _draw_wander(panels[0, 1], wander)
    step = Body(box(0.2, 0.2, HEIGHT), Pose.of(np.eye(3), [-0.1, 0.0, 0.0]))
    bar = Body(box(BAR, 0.2, HEIGHT), Pose.identity())
    fixed = {model.value: realise(model, generator("picture", model)) for model in FingerModel if model != "random"}
    fingers = fixed | {f"random {k}": finger for k, finger in enumerate(draws)}
    _draw_scan(panels[1, 0], World([step], TABLE), fingers, "a step of 3 cm")
    _draw_scan(panels[1, 1], World([bar], TABLE), fingers, "a bar, 2 cm wide and 3 cm high")
    panels[1, 1].legend(fontsize=7, loc="upper right")
    save_small(figure, path, 110)


def _draw_curves(axes: Any, curves: Mapping[str, tuple[Array, Array]]) -> None:
    for k, (name, (distances, errors)) in enumerate(curves.items()):
        for j, row in enumerate(errors[:9]):
            rest = row - np.polynomial.Polynomial.fit(distances, row, 1)(distances)
            axes.plot(_MM * distances, _MM * rest, color=f"C{k}", lw=0.8, label=None if j else name)
    axes.set(title="error over the range, less the line that fits best", xlabel="distance, mm", ylabel="mm")
    axes.legend(fontsize=7)


def _draw_wander(axes: Any, wander: Mapping[str, tuple[Sequence[float], Array]]) -> None:
    for name, (seconds, values) in wander.items():
        axes.loglog(seconds, _MM * values, "o-", ms=3, lw=1, label=name)
    axes.set(title="a wall that stands still: standard deviation between means", xlabel="over, s", ylabel="mm")
    axes.legend(fontsize=7)


def _draw_scan(axes: Any, world: World, fingers: Mapping[str, Finger], title: str) -> None:
    x = np.linspace(-_SPAN, _SPAN, 201)
    down = np.tile([0.0, 0.0, -1.0], (len(x), 1))
    surface = TIP - world.cast(np.stack([x, np.zeros_like(x), np.full_like(x, TIP)], axis=1), down)
    axes.fill_between(_MM * x, _MM * surface, -5, color="0.85", lw=0)
    for k, (name, finger) in enumerate(fingers.items()):
        poses, rng = face_down(x, np.full_like(x, TIP)), generator("scan", name)
        ranges = np.stack([measure_scan(finger, world, poses, rng)[0] for _ in range(_SCANS)])
        there = np.isfinite(ranges).mean(axis=0) > 0.5
        shown = np.nanmedian(np.where(there, ranges, 0.0), axis=0)
        axes.plot(_MM * x, _MM * np.where(there, TIP - shown, np.nan), lw=1, color=f"C{k}", label=name)
    axes.set(
        title=f"{title}, median of {_SCANS} scans",
        xlabel="mm along the scan",
        ylabel="tip height less range, mm",
    )
    axes.set_ylim(-8, 40)
