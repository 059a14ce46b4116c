"""The results of an evaluation: a row for each scan, its details, and the run that they belong to."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pretouch.estimate import Estimate
from pretouch.session import Proposer, State
from pretouch_simulation.protocol import Case


@dataclass(frozen=True)
class Row:
    """The state after one scan of one run; metres and seconds.

    Attributes:
        scan: 1, 2, ...
        initial_error, error: mean distance of the object's points from their true place, before and now.
        expected_error: what the estimate itself expects of `error`.
        covered: the truth lies in the stated 95 % region.
        state: of the session.
        fraction: share of the object's visible cloud scanned so far.
        robot_seconds: spent by all scans so far.
        compute_ms: from this scan's samples to the next plan; for the first scan, opening the session is added.
        camera: the simulated one, or `real`.
        scan_seconds: the duration of this scan.
        returns: share of this scan's samples that returned; None for points, of which there is none without a return.
        scene: `alone`, or `clutter` where other things stand around; None for a real frame.
        frame: the real frame; None for a view of a mesh.
        error_fitted: of a real frame: as `error`, from `fit_truth`.
        campaign, position: which campaign, from 0, and its how manieth object, from 1; these and what follows are None
            outside of campaigns. There a session that ends without a scan has one row too, with `scan` 0.
        knock: the camera was knocked before this session or an earlier one of the campaign.
        prior_error: as `error`, of what the session believed before its first scan.
        prior_covered: the truth lies in the 95 % region of that.
        drift: what the sessions up to this one say of the camera: steady, suspected or moved; None without `camera.id`.
    """

    mesh: str
    view: int
    scan: int
    proposer: str
    engine: str
    planner: str
    sensor: str
    initial_error: float
    error: float
    expected_error: float
    covered: bool
    state: str
    fraction: float
    robot_seconds: float
    compute_ms: float
    camera: str
    scan_seconds: float
    returns: float | None = None
    scene: str | None = None
    frame: str | None = None
    error_fitted: float | None = None
    campaign: int | None = None
    position: int | None = None
    knock: bool | None = None
    prior_error: float | None = None
    prior_covered: bool | None = None
    drift: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """For programs; members that are None are left out."""
        return {name: value for name, value in asdict(self).items() if value is not None}


@dataclass(frozen=True)
class Detail:
    """The details of one row: the error as a pose, and relative to the stated covariance C.

    Attributes:
        deviation: (6,) the pose error e in C's order, rotation vector and translation; rad and m.
        whitened: (6,) L^-1 e with C = L L^T, L lower triangular: standard normal if C is honest.
        distance2: e^T C^-1 e, the sum of the squares of `whitened`: chi-square of 6 degrees of freedom if C is honest.
        error_quantile: m, what the estimate states as the 95 % quantile of its error.
        weakest: the direction that the estimate calls most free, in words; empty if there is none.
        samples, inliers: of all scans so far.
    """

    deviation: tuple[float, ...]
    whitened: tuple[float, ...]
    distance2: float
    error_quantile: float
    weakest: str
    samples: int
    inliers: int

    @staticmethod
    def of(case: Case, estimate: Estimate) -> Detail:
        """The deviation of `estimate` from the truth of `case`."""
        deviation = case.deviation(estimate)
        whitened = np.linalg.solve(np.linalg.cholesky(estimate.covariance), deviation)
        return Detail(
            deviation=tuple(deviation.tolist()),
            whitened=tuple(whitened.tolist()),
            distance2=float(whitened @ whitened),
            error_quantile=estimate.error_quantile,
            weakest=estimate.unobservable[0].text if estimate.unobservable else "",
            samples=estimate.samples,
            inliers=estimate.inliers,
        )


@dataclass(frozen=True, eq=False, repr=False)  # asyncio.run formats its result; with arrays that takes seconds
class Outcome:
    """Where a run stands after one of its scans; see `Row` for its members.

    Attributes:
        seconds: of computing, from the scan's samples on.
    """

    proposer: Proposer
    estimate: Estimate
    state: State
    fraction: float
    robot_seconds: float
    scan_seconds: float
    returns: float | None
    seconds: float


class RunKey(NamedTuple):
    """Identifies a run within its evaluation."""

    mesh: str
    view: int
    engine: str
    sensor: str
    camera: str
    scene: str | None = None
    frame: str | None = None


@dataclass(frozen=True)
class Run:
    """The results of one view of one mesh with one engine and one sensor; `camera`, `scene` and `frame` as in `Row`.

    Attributes:
        initial_error: m; None if the run failed before there was one.
        details: one for each of `rows`.
        problem: why it failed, else empty.
    """

    mesh: str
    view: int
    engine: str
    sensor: str
    camera: str
    initial_error: float | None
    rows: tuple[Row, ...] = ()
    details: tuple[Detail, ...] = ()
    problem: str = ""
    scene: str | None = None
    frame: str | None = None

    @property
    def key(self) -> RunKey:
        return RunKey(self.mesh, self.view, self.engine, self.sensor, self.camera, self.scene, self.frame)

    def as_dict(self) -> dict[str, Any]:
        return {**asdict(self), "rows": [row.as_dict() for row in self.rows]}

    @staticmethod
    def from_dict(values: dict[str, Any]) -> Run:
        rows = tuple(Row(**row) for row in values["rows"])
        details = tuple(
            Detail(**{**detail, "deviation": tuple(detail["deviation"]), "whitened": tuple(detail["whitened"])})
            for detail in values["details"]
        )
        return Run(**{**values, "rows": rows, "details": details})


def write_details(path: Path, runs: Sequence[Run]) -> None:
    """Writes a JSON line for each row: what identifies it, then the members of its `Detail`."""
    with path.open("w") as file:
        for run in runs:
            for row, detail in zip(run.rows, run.details, strict=True):
                key = {name: value for name, value in run.key._asdict().items() if value is not None}
                file.write(json.dumps({**key, "scan": row.scan, "sensor": row.sensor, **asdict(detail)}) + "\n")
