"""One run of the evaluation: a session on one view, through the code of the services, judged after every scan."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from pretouch_orchestrator.loop import Loop
from pretouch_orchestrator.record import Record
from pretouch_registrar.engines import Engine

from pretouch.errors import PretouchError
from pretouch.geometry import Pose
from pretouch.session import Budget, Planner, Proposer, SessionRequest, Tolerance
from pretouch_simulation.finger import FingerModel, sensor_of
from pretouch_simulation.in_process import InProcessDetector, InProcessRegistrar
from pretouch_simulation.mesh import load_mesh
from pretouch_simulation.objects import box
from pretouch_simulation.protocol import Case, generator, make_case
from pretouch_simulation.scanning import scan_along

NEVER_CONVERGED = 1e-6
"""m: a tolerance that no estimate meets."""


@dataclass(frozen=True)
class Protocol:
    """What is evaluated; two runs with equal ones give equal rows, but for `compute_ms`.

    Attributes:
        scans: how many are made at most.
        proposer: None lets the detector choose.
        tolerance: m; a session that reaches it stops.
        paper_setting: the paper's own way of testing, see `paper_setting.py`.
    """

    scans: int
    proposer: Proposer | None
    engine: Engine
    planner: Planner
    sensor: FingerModel
    seed: int
    tolerance: float = NEVER_CONVERGED
    paper_setting: bool = False


@dataclass(frozen=True)
class Row:
    """The state after one scan of one run; metres and seconds.

    Attributes:
        scan: 1, 2, ...
        initial_error, error: mean distance of the object's points from their true place, before and now.
        expected_error: what the estimate itself expects of `error`.
        covered: the truth lies in the stated 95 % region.
        fraction: share of the object's visible cloud scanned so far.
        robot_seconds: spent by all scans so far.
        compute_ms: from this scan's samples to the next plan; for the first scan, opening the session is added.
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
    fraction: float
    robot_seconds: float
    compute_ms: float


@dataclass(frozen=True)
class Run:
    """All that came of one view of one mesh.

    Attributes:
        initial_error: m; None if the run failed before there was one.
        problem: why it failed, else empty.
    """

    mesh: str
    view: int
    initial_error: float | None
    rows: tuple[Row, ...]
    problem: str = ""

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    @staticmethod
    def from_dict(values: dict[str, Any]) -> Run:
        return Run(**{**values, "rows": tuple(Row(**row) for row in values["rows"])})


def run_view(path: Path, view: int, protocol: Protocol) -> Run:
    """One run; the seeds are fixed by the file's stem, the view and the protocol's seed.

    An error of pretouch's own is part of the result; any other is raised.
    """
    name = path.stem
    initial: float | None = None
    try:
        case = make_case(name, load_mesh(path), view, protocol.seed)
        initial = case.error(Pose.identity())
        if protocol.paper_setting:
            from pretouch_simulation.paper_setting import run_case as run_in_paper_setting

            rows = asyncio.run(run_in_paper_setting(case, protocol))
        else:
            rows = asyncio.run(_run_case(case, protocol))
    except PretouchError as error:
        return Run(name, view, initial, (), f"{error.detail} {error.remedy}".strip())
    return Run(name, view, initial, tuple(rows))


def warm_up(protocol: Protocol) -> None:
    """Compiles and loads whatever a run needs, so that `compute_ms` does not count it."""
    with suppress(PretouchError):  # a proposer that is not ready is said of every run
        asyncio.run(_run_case(make_case("warm-up", box(), 0), replace(protocol, scans=1)))


def request_of(case: Case, protocol: Protocol) -> SessionRequest:
    """What a client asks for: budgets so wide that only the number of scans counts."""
    return SessionRequest(
        camera=case.camera,
        base_T_camera=case.base_T_camera,
        depth_scale=1.0,
        tolerance=Tolerance(error=protocol.tolerance),
        budget=Budget(scans=protocol.scans, seconds=1e6, fraction=1.0),
        sensor=sensor_of(protocol.sensor),
        proposer=protocol.proposer,
        planner=protocol.planner,
    )


def loop_of(protocol: Protocol) -> Loop:
    """The orchestrator's own loop over the services' own code."""
    return Loop(InProcessDetector(), InProcessRegistrar(protocol.engine))


async def _run_case(case: Case, protocol: Protocol) -> list[Row]:
    loop = loop_of(protocol)
    started = time.perf_counter()
    record = await loop.open(f"{case.name}-{case.view}", 0.0, request_of(case, protocol), case.depth, case.mask)
    opening = time.perf_counter() - started
    initial = case.error(Pose.identity())
    rows: list[Row] = []
    while record.next_scan is not None and len(rows) < protocol.scans:
        plan = record.next_scan
        rng = generator("finger", protocol.seed, case.name, case.view, len(rows))
        samples = scan_along(case.world, plan.path, record.request.sensor, protocol.sensor, rng)
        started = time.perf_counter()
        record = await loop.advance(record, plan.scan_id, samples)
        seconds = time.perf_counter() - started + (opening if not rows else 0.0)
        rows.append(_row(case, protocol, record, len(rows) + 1, initial, seconds))
    return rows


def _row(case: Case, protocol: Protocol, record: Record, scan: int, initial: float, seconds: float) -> Row:
    return Row(
        mesh=case.name,
        view=case.view,
        scan=scan,
        proposer=record.proposer.value,
        engine=protocol.engine.value,
        planner=protocol.planner.value,
        sensor=protocol.sensor.value,
        initial_error=initial,
        error=case.error(record.estimate.base_T_correction),
        expected_error=record.estimate.expected_error,
        covered=case.covered(record.estimate),
        fraction=record.budget_used.fraction,
        robot_seconds=record.budget_used.seconds,
        compute_ms=1000.0 * seconds,
    )
