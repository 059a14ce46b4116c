"""Plans in a picture: convergence, the first scan's returns, and the error, over the robot's seconds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pretouch_simulation.reliability import save_small

from experiments.plans_sessions import PlannedSession
from pretouch.geometry import Array

_COLOURS = ("#7f7f7f", "#d95f02", "#1b9e77", "#7570b3", "#e7298a", "#66a61e")
_CM = 100.0
_TICKS = (0.05, 0.1, 0.2, 0.5, 1, 2)


def save_picture(worlds: Mapping[str, Mapping[str, Sequence[PlannedSession]]], path: Path) -> None:
    """Writes a PNG: a row of panels for each world, a colour for each label."""
    from matplotlib.figure import Figure

    labels = list(dict.fromkeys(label for comparison in worlds.values() for label in comparison))
    colours = {label: _COLOURS[k % len(_COLOURS)] for k, label in enumerate(labels)}
    figure = Figure(figsize=(12.5, 2.9 * len(worlds) + 0.6), layout="constrained")
    panels = figure.subplots(len(worlds), 3, squeeze=False, width_ratios=(1.1, 0.8, 1.1))
    for (world, comparison), (converged, returns, error) in zip(worlds.items(), panels, strict=True):
        most = max(session.seconds[-1] for sessions in comparison.values() for session in sessions)
        times = np.linspace(0.0, most, 400)
        for place, (label, sessions) in enumerate(comparison.items()):
            _draw_convergence(converged, sessions, times, colours[label], f"{label}, n = {len(sessions)}")
            _draw_returns(returns, sessions, place, colours[label])
            _draw_errors(error, sessions, times, colours[label])
        converged.set(title=world, ylabel="converged, %", ylim=(-3, 103))
        returns.set(title="first scan: samples that return, %", ylim=(-3, 103))
        returns.set_xticks(range(len(comparison)), list(comparison))
        error.set(title="error: median, dashed 90th percentile", ylabel="cm", yscale="log")
        error.set_yticks(_TICKS, [f"{tick:g}" for tick in _TICKS])
        error.minorticks_off()
        error.set_ylim(0.04, 5)
        for axes in (converged, error):
            axes.set_xlabel("robot seconds, with approaches")
            axes.grid(alpha=0.3)
        converged.legend(fontsize=8)
    save_small(figure, path, 80)


def _draw_convergence(axes: Any, sessions: Sequence[PlannedSession], times: Array, colour: str, label: str) -> None:
    ends = np.array([session.seconds[-1] for session in sessions if session.converged])
    axes.plot(times, 100 * (ends[:, None] <= times).sum(axis=0) / len(sessions), color=colour, label=label)


def _draw_returns(axes: Any, sessions: Sequence[PlannedSession], place: int, colour: str) -> None:
    shares = 100 * np.array([session.rows[0]["returns"] for session in sessions])
    aside = place + 0.25 * np.sin(np.arange(len(shares)) * 2.4)
    axes.scatter(aside, shares, s=12, color=colour, alpha=0.6, linewidths=0)
    axes.plot([place - 0.35, place + 0.35], [np.median(shares)] * 2, color=colour, lw=2)


def _draw_errors(axes: Any, sessions: Sequence[PlannedSession], times: Array, colour: str) -> None:
    errors = _CM * np.stack([session.error_at(times) for session in sessions])
    for level, style in ((0.5, "-"), (0.9, "--")):
        axes.plot(times, np.quantile(errors, level, axis=0), style, color=colour)
