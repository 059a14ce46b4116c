"""Whole sessions by several proposers and planners, and their error as a function of the share scanned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pretouch_registrar.engines import Engine
from pretouch_simulation.evaluation import run_task
from pretouch_simulation.evaluation_protocol import Protocol
from pretouch_simulation.evaluation_tasks import MeshTask
from pretouch_simulation.finger import FingerModel

from pretouch.geometry import Array
from pretouch.session import Planner, Proposer


@dataclass(frozen=True)
class Course:
    """How one session went: a view of a mesh, its regions by `proposer`, their order by `planner`.

    Attributes:
        initial: m, the error before; None if the session failed before there was one.
        fractions, errors: share of the object scanned and error, m, after each scan.
        problem: why there are none, else empty.
    """

    mesh: str
    view: int
    proposer: str
    planner: str
    initial: float | None
    fractions: tuple[float, ...]
    errors: tuple[float, ...]
    problem: str = ""

    @property
    def key(self) -> tuple[str, int, str, str]:
        return self.mesh, self.view, self.proposer, self.planner

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    @staticmethod
    def from_dict(values: dict[str, Any]) -> Course:
        return Course(**{**values, "fractions": tuple(values["fractions"]), "errors": tuple(values["errors"])})


def protocol_of(proposer: Proposer, planner: Planner, scans: int, sensor: FingerModel, seed: int) -> Protocol:
    """The evaluation protocol with engine `posterior`; a session ends after `scans` only, or without a region left."""
    return Protocol(scans, proposer, Engine.POSTERIOR, planner, sensor, seed)


def run_session(path: Path, view: int, proposer: Proposer, planner: Planner, protocol: Protocol) -> Course:
    """Runs the session; an error of pretouch's own becomes the course's `problem`."""
    run = run_task(MeshTask(path, view), [protocol])[0]
    fractions, errors = (tuple(getattr(row, name) for row in run.rows) for name in ("fraction", "error"))
    return Course(path.stem, view, proposer.value, planner.value, run.initial_error, fractions, errors, run.problem)


def errors_at(courses: Sequence[Course], fractions: ArrayLike) -> Array:
    """(n, f), m: each session's error once its next scan would exceed that share of the object.

    Before the first scan it is the initial error; a session that ended keeps its last.
    """
    shares = np.asarray(fractions, dtype=np.float64)
    made = [np.searchsorted(np.maximum.accumulate([0.0, *c.fractions]), shares, side="right") - 1 for c in courses]
    levels = [np.array([c.initial, *c.errors], dtype=np.float64) for c in courses]
    return np.array([level[k] for level, k in zip(levels, made, strict=True)]).reshape(len(courses), len(shares))


def means_after_scan(courses: Sequence[Course], scan: int) -> tuple[float, float]:
    """Mean share scanned and mean error, m, after `scan` scans; ended sessions count with their last state."""
    fractions = [[0.0, *c.fractions][min(scan, len(c.fractions))] for c in courses]
    errors = [[c.initial, *c.errors][min(scan, len(c.errors))] for c in courses]
    return float(np.mean(fractions)), float(np.mean(np.array(errors, dtype=np.float64)))


def share_to_reach(courses: Sequence[Course], error: float, upto: float = 1.0) -> float:
    """The least share, to 0.5 %, at which the mean error is at most `error`, m; NaN if there is none."""
    shares = np.arange(round(200 * upto) + 1) / 200
    below = errors_at(courses, shares).mean(axis=0) <= error
    return float(shares[np.argmax(below)]) if below.any() else float("nan")
