"""Sessions as the rows of an evaluation tell them: what was known after how many seconds of the robot's time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np
from pretouch_simulation.evaluation_convergence import add_approaches

from pretouch.geometry import Array
from pretouch.session import State

Key = tuple[str, ...]
"""What a session has in common with those of other evaluations: frame, mesh, view, camera, sensor and scene."""
_NEEDED = ("state", "scan", "initial_error", "error", "covered", "robot_seconds", "returns")
_KEYS = ("frame", "mesh", "view", "camera", "sensor", "scene")


@dataclass(frozen=True)
class PlannedSession:
    """One session.

    Attributes:
        rows: as `pretouch evaluate` writes them, one for each scan, at least one.
    """

    rows: Sequence[Mapping[str, Any]]

    @property
    def last(self) -> Mapping[str, Any]:
        return self.rows[-1]

    @property
    def converged(self) -> bool:
        return bool(self.last["state"] == State.CONVERGED)

    @cached_property
    def seconds(self) -> Array:
        """(k,), s: of the robot up to the end of each scan, with the way to each."""
        return np.array([add_approaches(row["robot_seconds"], row["scan"]) for row in self.rows])

    def error_after(self, scan: int | None) -> float:
        """m, after `scan` scans; None: after the last. A session that ended keeps its last error."""
        return float(self.rows[-1 if scan is None else min(scan, len(self.rows)) - 1]["error"])

    def error_at(self, seconds: Array) -> Array:
        """(s,), m: the error when `seconds` (s,) of the robot's time have passed; at first the initial one."""
        errors = np.array([self.rows[0]["initial_error"], *(row["error"] for row in self.rows)])
        return np.asarray(errors[np.searchsorted(self.seconds, seconds, side="right")])


def sessions_of(rows: Iterable[Mapping[str, Any]]) -> dict[Key, PlannedSession]:
    """The sessions of an evaluation's rows, which are in the order of their scans.

    Raises:
        KeyError: a row lacks one of the members that plans are compared by.
    """
    return {key: PlannedSession(tuple(group)) for key, group in groupby(rows, key=_key_of)}


def _key_of(row: Mapping[str, Any]) -> Key:
    if missing := [name for name in _NEEDED if name not in row]:
        raise KeyError(*missing)
    return tuple(str(row.get(name, "")) for name in _KEYS)
