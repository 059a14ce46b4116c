"""The page and the picture of `experiments.forecast`: what was stated against what became of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pretouch_simulation.markdown import markdown_table
from scipy.stats import beta

from pretouch.geometry import Array
from pretouch.session import Forecast

_BINS = 5


class Course(Protocol):
    """What is shown of a session: see `experiments.forecast.Row`."""

    @property
    def spent(self) -> list[float]: ...

    @property
    def seconds(self) -> float: ...

    @property
    def forecasts(self) -> list[Forecast]: ...

    @property
    def converged(self) -> bool: ...


class States(NamedTuple):
    """States of sessions, one each: stated scans, seconds and chance (n, 3), and what became of them (n,)."""

    stated: Array
    scans: Array
    seconds: Array
    converged: Array


def collect_states(courses: Sequence[Course], scans: int) -> States:
    """The states after so many scans of the sessions that then awaited another."""
    chosen = [course for course in courses if len(course.forecasts) > scans]
    return States(
        np.array([astuple(course.forecasts[scans]) for course in chosen]).reshape(-1, 3),
        np.array([len(course.forecasts) - scans for course in chosen], dtype=np.float64),
        np.array([course.seconds - course.spent[scans] for course in chosen]),
        np.array([float(course.converged) for course in chosen]),
    )


def binomial_interval(successes: int, n: int) -> tuple[float, float]:
    """95 % interval of a share (Clopper and Pearson 1934)."""
    low = 0.0 if successes == 0 else float(beta.ppf(0.025, successes, n - successes + 1))
    high = 1.0 if successes == n else float(beta.ppf(0.975, successes + 1, n - successes))
    return low, high


def write_report(by_world: Mapping[str, Sequence[Course]], command: str, out: Path) -> None:
    """Writes forecast.md and forecast.png into the folder `out`."""
    stages = {
        f"{world}, {name}": states
        for world, courses in by_world.items()
        for scans, name in enumerate(("at creation", "after one scan"))
        if len((states := collect_states(courses, scans)).scans)
    }
    counts = ", ".join(f"{len(courses)} in `{world}`" for world, courses in by_world.items() if courses)
    (out / "forecast.md").write_text(_write_page(counts, stages, command))
    _draw(stages, out / "forecast.png")


def _group(stated: Array) -> list[NDArray[np.intp]]:
    """Indices of groups of equally many states, in the order of what was stated."""
    return [group for group in np.array_split(np.argsort(stated, kind="stable"), _BINS) if len(group)]


def _write_page(counts: str, stages: dict[str, States], command: str) -> str:
    chances, efforts, scores = [], [], []
    for name, states in stages.items():
        stated = states.stated[:, 2]
        for group in _group(stated):
            successes = int(states.converged[group].sum())
            low, high = binomial_interval(successes, len(group))
            chances.append(
                (
                    name,
                    str(len(group)),
                    f"{stated[group].mean():.0%}",
                    f"{successes / len(group):.0%} ({low:.0%} to {high:.0%})",
                )
            )
        base = states.converged.mean()
        brier, climate = np.mean((stated - states.converged) ** 2), base * (1 - base)
        scores.append((name, str(len(stated)), f"{stated.mean():.0%}", f"{base:.0%}", f"{brier:.3f}", f"{climate:.3f}"))
        for k, (what, needed) in enumerate((("scans", states.scans), ("robot seconds", states.seconds))):
            efforts += [
                (name, what, str(len(group)), f"{states.stated[group, k].mean():.1f}", f"{needed[group].mean():.1f}")
                for group in _group(states.stated[:, k])
            ]
    return "\n".join(
        [
            "# What sessions are forecast to take\n",
            f"Made by `{command}` and the same in the other world: sessions on views of the split's meshes, {counts}, "
            "which are simulated; tolerances of 2, 3, 5, 8 or 12 mm, budgets of 2, 4 or 10 scans and 15, 40 or 120 "
            "robot seconds, a quarter of them with one visible point as `tolerance.at`; robots that finish their "
            "scans. The coefficients were fitted to other sessions, on the training side of the meshes. Groups are of "
            "equally many sessions by what was stated; intervals are of 95 %.\n",
            "![Chance, scans and seconds stated against what became of them](forecast.png)\n",
            "Brier score: mean squared difference of the chance and the outcome; that of the overall share is what a "
            "forecast without any knowledge of the session would reach.\n",
            markdown_table(
                ("forecast", "n", "mean chance", "converged", "Brier score", "of the overall share"), scores
            ),
            "\nThe chance to converge within the budget:\n",
            markdown_table(("forecast", "n", "stated", "converged"), chances),
            "\nScans and robot seconds until the session ends, means:\n",
            markdown_table(("forecast", "what", "n", "stated", "needed"), efforts),
        ]
    )


def _draw(stages: dict[str, States], path: Path) -> None:
    figure = Figure(figsize=(12, 4), layout="constrained")
    chance, scans, seconds = figure.subplots(1, 3)
    for (name, states), colour in zip(stages.items(), ("#1b9e77", "#d95f02", "#7570b3", "#e7298a"), strict=False):
        stated = states.stated[:, 2]
        groups = _group(stated)
        shares = [states.converged[group].mean() for group in groups]
        limits = [binomial_interval(int(states.converged[group].sum()), len(group)) for group in groups]
        errors = [
            [share - low for share, (low, _) in zip(shares, limits, strict=True)],
            [high - share for share, (_, high) in zip(shares, limits, strict=True)],
        ]
        chance.errorbar(
            [stated[group].mean() for group in groups], shares, errors, fmt="o-", color=colour, capsize=3,
            label=f"{name}, n = {len(stated)}",
        )  # fmt: skip
        for k, (axes, needed) in enumerate(((scans, states.scans), (seconds, states.seconds))):
            axes.plot(states.stated[:, k], needed, ".", color=colour, alpha=0.3)
            means = [(states.stated[group, k].mean(), needed[group].mean()) for group in _group(states.stated[:, k])]
            axes.plot(*np.array(means).T, "o-", color=colour, label=f"{name}, means of fifths")
    chance.plot([0, 1], [0, 1], color="black", linewidth=0.8)
    chance.set(xlabel="chance stated", ylabel="share that converged, with its 95 % interval", xlim=(0, 1), ylim=(0, 1))
    for axes, what in ((scans, "further scans"), (seconds, "further robot seconds")):
        limit = max(axes.get_xlim()[1], axes.get_ylim()[1])
        axes.plot([0, limit], [0, limit], color="black", linewidth=0.8)
        axes.set(xlabel=f"{what} stated", ylabel=f"{what} needed")
    for axes in (chance, scans, seconds):
        axes.legend(fontsize=7, loc="lower right")
    figure.savefig(path, dpi=110)
