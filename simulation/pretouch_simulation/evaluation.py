"""The runs of one view: sessions through the code of the services, judged after every scan."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from pretouch_orchestrator.loop import Loop
from pretouch_orchestrator.record import Record
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar, Settings

from pretouch.errors import PretouchError
from pretouch.geometry import Pose
from pretouch.session import Budget, Planner, Proposer, SessionRequest, Tolerance
from pretouch_simulation.evaluation_rows import Detail, Row, Run
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
        leader: the engine by whose estimates the scans are planned, so that all engines are given the same ones;
            None: the whole loop runs on `engine`.
    """

    scans: int
    proposer: Proposer | None
    engine: Engine
    planner: Planner
    sensor: FingerModel
    seed: int
    tolerance: float = NEVER_CONVERGED
    paper_setting: bool = False
    leader: Engine | None = None


@dataclass(frozen=True, eq=False, repr=False)  # asyncio.run spells out what it returns, arrays too: seconds a run
class Step:
    """A session after one of its scans, and the seconds that it took to get there from the scan's samples."""

    record: Record
    seconds: float


def run_view(path: Path, view: int, protocols: Sequence[Protocol]) -> list[Run]:
    """A run by each of the protocols, all on the same images; they may differ in engine and sensor.

    The seeds are fixed by the file's stem, the view and the protocol's seed. An error of pretouch's own is part of the
    result; any other is raised.
    """
    name = path.stem
    try:
        case = make_case(name, load_mesh(path), view, protocols[0].seed)
    except PretouchError as error:
        return [_failed(name, view, protocol, None, error) for protocol in protocols]
    return list(_runs(case, protocols))


def _runs(case: Case, protocols: Sequence[Protocol]) -> Iterator[Run]:
    initial = case.error(Pose.identity())
    led: dict[FingerModel, list[Step]] = {}
    registrar = Registrar()
    for protocol in protocols:
        try:
            if protocol.paper_setting:
                from pretouch_simulation.paper_setting import run_case

                rows, details = asyncio.run(run_case(case, protocol, registrar))
            else:
                steps = _steps(case, protocol, led, registrar)
                rows = [_row(case, protocol, step, k, initial) for k, step in enumerate(steps, start=1)]
                details = [Detail.of(case, step.record.estimate) for step in steps]
        except PretouchError as error:
            yield _failed(case.name, case.view, protocol, initial, error)
        else:
            engine, sensor = protocol.engine.value, protocol.sensor.value
            yield Run(case.name, case.view, engine, sensor, initial, tuple(rows), tuple(details))


def _failed(name: str, view: int, protocol: Protocol, initial: float | None, error: PretouchError) -> Run:
    text = f"{error.detail} {error.remedy}".strip()
    return Run(name, view, protocol.engine.value, protocol.sensor.value, initial, problem=text)


def warm_up(protocols: Sequence[Protocol]) -> None:
    """Compiles and loads whatever a run needs, so that `compute_ms` does not count it."""
    case, registrar = make_case("warm-up", box(), 0), Registrar()
    for protocol in protocols:
        with suppress(PretouchError):  # a proposer that is not ready is said of every run
            asyncio.run(_session(case, replace(protocol, scans=1), registrar))


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


def loop_of(protocol: Protocol, registrar: Registrar) -> Loop:
    """The orchestrator's own loop over the services' own code."""
    return Loop(InProcessDetector(), InProcessRegistrar(protocol.engine, registrar))


def steps_of(case: Case, protocol: Protocol, upto: int) -> list[Step]:
    """The session on `case` that the protocol's rows are made of, after each of its first `upto` scans at most."""
    registrar = Registrar()
    led = replace(protocol, engine=protocol.leader or protocol.engine)
    steps = asyncio.run(_session(case, led, registrar, upto))
    return [_rematched(step, protocol, registrar) for step in steps]


def _steps(case: Case, protocol: Protocol, led: dict[FingerModel, list[Step]], registrar: Registrar) -> list[Step]:
    """The protocol's session on `case`; `led` keeps the leader's ones, by sensor."""
    if protocol.leader is None:
        return asyncio.run(_session(case, protocol, registrar))
    if protocol.sensor not in led:
        led[protocol.sensor] = asyncio.run(_session(case, replace(protocol, engine=protocol.leader), registrar))
    return [_rematched(step, protocol, registrar) for step in led[protocol.sensor]]


async def _session(case: Case, protocol: Protocol, registrar: Registrar, upto: int | None = None) -> list[Step]:
    loop = loop_of(protocol, registrar)
    most = protocol.scans if upto is None else min(upto, protocol.scans)
    started = time.perf_counter()
    record = await loop.open(f"{case.name}-{case.view}", 0.0, request_of(case, protocol), case.depth, case.mask)
    opening = time.perf_counter() - started
    steps: list[Step] = []
    while record.next_scan is not None and len(steps) < most:
        plan = record.next_scan
        rng = generator("finger", protocol.seed, case.name, case.view, len(steps))
        samples = scan_along(case.world, plan.path, record.request.sensor, protocol.sensor, rng)
        started = time.perf_counter()
        record = await loop.advance(record, plan.scan_id, samples)
        seconds = time.perf_counter() - started + (opening if not steps else 0.0)
        steps.append(Step(record, seconds))
    return steps


def _rematched(step: Step, protocol: Protocol, registrar: Registrar) -> Step:
    """The leader's scans matched by the protocol's engine, the time being the match's alone; its own as they are."""
    if protocol.leader in (None, protocol.engine):
        return step
    record = step.record
    settings = Settings(protocol.engine, record.request.prior, record.request.sensor)
    started = time.perf_counter()
    estimate = registrar.register(record.scene, record.measured, settings)
    return Step(replace(record, estimate=estimate), time.perf_counter() - started)


def _row(case: Case, protocol: Protocol, step: Step, scan: int, initial: float) -> Row:
    record = step.record
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
        compute_ms=1000.0 * step.seconds,
    )
