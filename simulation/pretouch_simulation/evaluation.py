"""The runs of one task: sessions through the code of the services, evaluated after every scan."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

from pretouch_orchestrator.sessions.loop import Loop, PredictPrior
from pretouch_orchestrator.sessions.record import Record
from pretouch_registrar.registration import Registrar, Settings

from pretouch.client import Reflex
from pretouch.errors import PretouchError
from pretouch.geometry import Pose
from pretouch.prior import AnyPrior
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.evaluation_protocol import Protocol, finger_of, loop_of, request_of
from pretouch_simulation.evaluation_rows import Detail, Outcome, Row, Run, RunKey
from pretouch_simulation.evaluation_tasks import Task
from pretouch_simulation.finger import Finger, FingerModel
from pretouch_simulation.fitted_truth import fit_truth
from pretouch_simulation.objects import box
from pretouch_simulation.paper_setting import run_case
from pretouch_simulation.protocol import Case, generator, make_case
from pretouch_simulation.scanning import scan_along
from pretouch_simulation.stopping import NOTHING, tell_until_enough


@dataclass(frozen=True, eq=False, repr=False)  # asyncio.run formats its result; with arrays that takes seconds
class Step:
    """A session after one of its scans, and the seconds of computing from the scan's samples to this state."""

    record: Record
    seconds: float

    @property
    def outcome(self) -> Outcome:
        record, scan = self.record, self.record.scans[-1]
        return Outcome(
            proposer=record.proposer,
            estimate=record.estimate,
            state=record.state,
            fraction=record.budget_used.fraction,
            robot_seconds=record.budget_used.seconds,
            scan_seconds=scan.duration,
            returns=scan.returns / scan.samples,
            seconds=self.seconds,
        )


@dataclass(frozen=True, eq=False)
class Subject:
    """A task as it is evaluated.

    Attributes:
        fitted: the case with the truth that `error_fitted` is measured from; None for a simulated view.
    """

    task: Task
    case: Case
    fitted: Case | None

    @staticmethod
    def of(task: Task, seed: int, camera: CameraModel) -> Subject:
        """Raises PretouchError where the task's files cannot be used."""
        case = task.case(seed, camera)
        return Subject(task, case, None if task.frame is None else replace(case, truth=fit_truth(case)))


def key_of(task: Task, protocol: Protocol) -> RunKey:
    """The key of the protocol's run of the task."""
    engine, sensor = protocol.engine.value, protocol.sensor.value
    return RunKey(task.mesh, task.view, engine, sensor, task.camera(protocol.camera), task.scene, task.frame)


def run_task(task: Task, protocols: Sequence[Protocol]) -> list[Run]:
    """Runs the task by each of the protocols; those with the same camera share images.

    The seeds are fixed by the task and the protocol's seed. An error of pretouch's own is part of the result; any other
    is raised.
    """
    runs: list[Run] = []
    registrar = Registrar()
    for camera in dict.fromkeys(protocol.camera for protocol in protocols):
        chosen = [protocol for protocol in protocols if protocol.camera is camera]
        try:
            subject = Subject.of(task, chosen[0].seed, camera)
        except PretouchError as error:
            runs += [_make_failed_run(task, protocol, None, error) for protocol in chosen]
        else:
            led: dict[FingerModel, list[Step]] = {}
            runs += [_run_protocol(subject, protocol, led, registrar) for protocol in chosen]
    return runs


def _run_protocol(
    subject: Subject, protocol: Protocol, led: dict[FingerModel, list[Step]], registrar: Registrar
) -> Run:
    initial = subject.case.error(Pose.identity())
    try:
        outcomes = _run_sessions(subject.case, protocol, led, registrar)
    except PretouchError as error:
        return _make_failed_run(subject.task, protocol, initial, error)
    rows = tuple(_row(subject, protocol, outcome, k, initial) for k, outcome in enumerate(outcomes, start=1))
    details = tuple(Detail.of(subject.case, outcome.estimate) for outcome in outcomes)
    key = key_of(subject.task, protocol)
    return Run(**key._asdict(), initial_error=initial, rows=rows, details=details)


def _run_sessions(
    case: Case, protocol: Protocol, led: dict[FingerModel, list[Step]], registrar: Registrar
) -> list[Outcome]:
    if protocol.paper_setting:
        return asyncio.run(run_case(case, protocol, registrar))
    return [step.outcome for step in _run_or_reuse_steps(case, protocol, led, registrar)]


def _make_failed_run(task: Task, protocol: Protocol, initial: float | None, error: PretouchError) -> Run:
    text = f"{error.detail} {error.remedy}".strip()
    return Run(**key_of(task, protocol)._asdict(), initial_error=initial, problem=text)


def warm_up(protocols: Sequence[Protocol]) -> None:
    """Compiles and loads whatever a run needs, so that `compute_ms` does not count it."""
    case, registrar = make_case("warm-up", box(), 0), Registrar()
    for protocol in protocols:
        with suppress(PretouchError):  # a proposer that is not ready is reported for every run
            asyncio.run(run_session(case, replace(protocol, scans=1), registrar))


def run_steps(case: Case, protocol: Protocol, upto: int) -> list[Step]:
    """Runs the protocol's session on `case`; its states after each of up to `upto` scans."""
    registrar = Registrar()
    led = replace(protocol, engine=protocol.leader or protocol.engine)
    steps = asyncio.run(run_session(case, led, registrar, upto))
    return [_rematch(step, protocol, registrar) for step in steps]


def _run_or_reuse_steps(
    case: Case, protocol: Protocol, led: dict[FingerModel, list[Step]], registrar: Registrar
) -> list[Step]:
    """The protocol's session on `case`; `led` caches the leader's sessions, by sensor."""
    if protocol.leader is None:
        return asyncio.run(run_session(case, protocol, registrar))
    if protocol.sensor not in led:
        led[protocol.sensor] = asyncio.run(run_session(case, replace(protocol, engine=protocol.leader), registrar))
    return [_rematch(step, protocol, registrar) for step in led[protocol.sensor]]


async def open_session(
    case: Case,
    protocol: Protocol,
    loop: Loop,
    finger: Finger,
    prior: AnyPrior | None = None,
    predict: PredictPrior | None = None,
) -> Record:
    """The session on `case` before its first scan; raises `PretouchError` where the services refuse it.

    Args:
        prior: what the session is told of the calibration error; None: nothing.
        predict: where it is told nothing, what is known of its camera.
    """
    request = replace(request_of(case, protocol), sensor=finger.sensor, prior=prior)
    return await loop.open(f"{case.name}-{case.view}", 0.0, request, case.depth, case.mask, predict)


async def run_session(
    case: Case,
    protocol: Protocol,
    registrar: Registrar,
    upto: int | None = None,
    finger: Finger | None = None,
    prior: AnyPrior | None = None,
) -> list[Step]:
    """Runs a session on `case`; its states after each of up to `upto` scans.

    Args:
        finger: replaces the protocol's own.
        prior: what the session is told of the calibration error; None: nothing.

    Raises:
        PretouchError: the services refuse it.
    """
    loop = loop_of(protocol, registrar)
    finger = finger or finger_of(case, protocol)
    most = protocol.scans if upto is None else min(upto, protocol.scans)
    started = time.perf_counter()
    record = await open_session(case, protocol, loop, finger, prior)
    opening = time.perf_counter() - started
    steps = await make_scans(record, case, protocol, loop, finger, most)
    return [replace(steps[0], seconds=steps[0].seconds + opening), *steps[1:]] if steps else []


async def make_scans(
    record: Record, case: Case, protocol: Protocol, loop: Loop, finger: Finger, most: int
) -> list[Step]:
    """Goes on with a session on `case`; its states after each of up to `most` scans. Raises as `run_session`."""
    steps = list[Step]()
    while record.next_scan is not None and len(steps) < most:
        plan = record.next_scan
        rng = generator("finger", protocol.seed, case.name, case.view, len(steps))
        reflex = Reflex() if record.request.scan.guarded else None
        samples = scan_along(case.world, plan.path, record.request.sensor, finger, rng, reflex)
        if protocol.stop:
            record, samples = await tell_until_enough(loop, record, samples), NOTHING
        started = time.perf_counter()
        record = await loop.advance(record, plan.scan_id, samples)
        steps.append(Step(record, time.perf_counter() - started))
    return steps


def _rematch(step: Step, protocol: Protocol, registrar: Registrar) -> Step:
    """Matches the leader's scans by the protocol's engine and times the match alone; the leader's own steps stay."""
    if protocol.leader in (None, protocol.engine):
        return step
    record = step.record
    settings = Settings(protocol.engine, record.prior, record.request.sensor)
    started = time.perf_counter()
    estimate = registrar.register(record.scene, record.measured, settings)
    return Step(replace(record, estimate=estimate), time.perf_counter() - started)


def _row(subject: Subject, protocol: Protocol, outcome: Outcome, scan: int, initial: float) -> Row:
    case, task, estimate = subject.case, subject.task, outcome.estimate
    correction = estimate.base_T_correction
    return Row(
        mesh=task.mesh,
        view=task.view,
        scan=scan,
        proposer=outcome.proposer.value,
        engine=protocol.engine.value,
        planner=protocol.planner.value,
        sensor="paper" if protocol.paper_setting else protocol.sensor.value,
        initial_error=initial,
        error=case.error(correction),
        expected_error=estimate.expected_error,
        covered=case.is_covered_by(estimate),
        state=outcome.state.value,
        fraction=outcome.fraction,
        robot_seconds=outcome.robot_seconds,
        compute_ms=1000.0 * outcome.seconds,
        camera=task.camera(protocol.camera),
        scan_seconds=outcome.scan_seconds,
        returns=outcome.returns,
        scene=task.scene,
        frame=task.frame,
        error_fitted=None if subject.fitted is None else subject.fitted.error(correction),
    )
