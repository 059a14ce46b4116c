"""The worst runs and their likely causes, judged with knowledge of the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from pretouch_orchestrator.sessions.record import Record
from pretouch_registrar.engines import Engine
from pretouch_registrar.engines.solution import pose_from_correction
from pretouch_registrar.registration import Registrar, Settings

from pretouch.geometry import Array
from pretouch.tof import Scan
from pretouch_simulation.evaluation_rows import Detail, Run
from pretouch_simulation.evaluation_summary import errors_after
from pretouch_simulation.protocol import CHI2_6_95, Case

_BEHIND = 0.008
"""m: a hit this far behind what the camera sees at its pixel is on a side that the camera cannot see."""
_TABLE = 0.005
"""m above the table below which a hit is the table's."""
_FLAT = float(np.cos(np.radians(15.0)))
"""A surface is flat here if its normal is within 15 degrees of the vertical."""
_FEW = 12
_SECOND = 0.5
"""A second mode must be nearer to the truth by this share of the error to be called the right one."""


class Met(StrEnum):
    """What a returned beam met."""

    SEEN = "seen by the camera"
    HIDDEN = "on the hidden side"
    BLIND = "where the camera has no depth"
    TABLE = "on the table"


@dataclass(frozen=True)
class Diagnosis:
    """The numbers of one run after some of its scans; metres.

    Attributes:
        distance2: of the truth, in the metric of the stated covariance; 12.59 is the limit of its 95 % region.
        weakest: the estimate's least certain direction; empty if there is none.
        beams, returns: of all scans so far.
        met: the number of returns from each kind of surface.
        flat: share of the hits on the object that met a level surface.
        second_distance: mean distance of the object's points between the estimate and the engine's second mode; None
            if it has no second mode.
        second_error: the error of that mode.
    """

    error: float
    expected_error: float
    distance2: float
    weakest: str
    beams: int
    returns: int
    met: dict[Met, int]
    flat: float
    second_distance: float | None
    second_error: float | None

    @property
    def on_object(self) -> int:
        return self.returns - self.met[Met.TABLE]

    @property
    def reason(self) -> str:
        """The likeliest cause, in a line."""
        hidden = self.met[Met.HIDDEN] + self.met[Met.BLIND]
        if self.on_object < _FEW:
            return f"too few returns from the object: {self.on_object} of {self.beams} beams"
        if self.second_distance is not None and (self.second_error or 0.0) < (1 - _SECOND) * self.error:
            return f"two places agree: the right one is {100 * self.second_distance:.1f} cm away"
        if hidden > 0.4 * self.on_object:
            return f"hits where the camera saw nothing: {hidden / self.on_object:.0%} of those on the object"
        if self.flat > 0.85:
            return f"level surfaces only ({self.flat:.0%} of the hits): free sideways"
        if self.distance2 > CHI2_6_95:
            return f"surer than it should be: expected {100 * self.expected_error:.2f} cm, d2 = {self.distance2:.0f}"
        if self.weakest:
            return f"said to be free: {self.weakest}"
        return "no single cause stands out"


def worst_runs(runs: Sequence[Run], scan: int, count: int) -> list[Run]:
    """The `count` runs with the largest errors after `scan` scans, the worst first; failed ones are left out."""
    scanned = [run for run in runs if run.rows]
    order = np.argsort(-errors_after(scanned, scan), kind="stable")
    return [scanned[k] for k in order[:count]]


def diagnose(case: Case, record: Record, engine: Engine) -> Diagnosis:
    """Diagnoses the session `record` on `case`, whose estimate is by `engine`."""
    scan = Scan.concatenate(list(record.measured))
    kinds = identify_surfaces(case, scan.points())
    detail = Detail.of(case, record.estimate)
    error = case.error(record.estimate.base_T_correction)
    second = _second_place(case, record, engine)
    return Diagnosis(
        error=error,
        expected_error=record.estimate.expected_error,
        distance2=detail.distance2,
        weakest=detail.weakest,
        beams=len(scan),
        returns=len(kinds),
        met={kind: int((kinds == kind).sum()) for kind in Met},
        flat=_flat_share(case, scan, kinds),
        second_distance=second and second[0],
        second_error=second and second[1],
    )


def identify_surfaces(case: Case, points: Array) -> NDArray[np.str_]:
    """(n,) `Met` of points (n, 3), m, in base, as the finger found them."""
    in_camera = case.base_T_camera.inverse().apply(case.truth.inverse().apply(points))
    height, width = case.mask.shape
    u, v = np.rint(case.camera.project(in_camera)).astype(np.intp).T
    inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    depth = np.where(inside, case.depth.metres[v.clip(0, height - 1), u.clip(0, width - 1)], 0.0)
    behind = in_camera[:, 2] - depth > _BEHIND
    table = case.world.table.height(points) < _TABLE
    kinds = np.select([table, depth == 0, behind], [Met.TABLE, Met.BLIND, Met.HIDDEN], Met.SEEN)
    return np.asarray(kinds, dtype=np.str_)


def _flat_share(case: Case, scan: Scan, kinds: NDArray[np.str_]) -> float:
    hit = scan.returned
    normals = case.world.trace(scan.origins[hit], scan.directions[hit]).normals[kinds != Met.TABLE]
    return float((np.abs(normals @ case.world.table.normal) > _FLAT).mean()) if len(normals) else 0.0


def _second_place(case: Case, record: Record, engine: Engine) -> tuple[float, float] | None:
    """Distance of the engine's second mode from its best one, and its error, m; None without a second mode."""
    settings = Settings(engine, record.prior, record.request.sensor)
    others = Registrar().solve(record.scene, record.measured, settings).other_modes
    if len(others) == 0:
        return None
    second = pose_from_correction(others[0], record.scene.centroid)
    apart = second.apply(case.cloud) - record.estimate.base_T_correction.apply(case.cloud)
    return float(np.linalg.norm(apart, axis=1).mean()), case.error(second)
