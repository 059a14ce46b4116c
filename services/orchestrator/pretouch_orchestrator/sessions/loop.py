"""The closed loop of a session: perceive, plan, scan, register, until it ends."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
import structlog
from numpy.typing import NDArray

from pretouch.camera import DepthImage
from pretouch.errors import RefusedForSize, TooLarge, Unavailable, problem
from pretouch.estimate import Estimate, from_prior
from pretouch.exhaustion import Exhaustion
from pretouch.geometry import Array, Pose
from pretouch.prior import AnyPrior, Prior
from pretouch.scan_prediction import Candidate
from pretouch.session import GatewaySpan, Planner, Points, Region, ScanPlan, SessionRequest, Skipped, State, Submission
from pretouch.session_warning import merge_warnings
from pretouch.tof import RangeSamples, Scan
from pretouch_orchestrator.perception.object_symmetry import check_symmetry
from pretouch_orchestrator.perception.preparation import estimate_preparation, prepare_scene
from pretouch_orchestrator.planning.candidates import CandidatePath
from pretouch_orchestrator.planning.planner import Option
from pretouch_orchestrator.sessions.budget import find_limit, select_affordable
from pretouch_orchestrator.sessions.endings import end_session, exhaust_session, has_converged
from pretouch_orchestrator.sessions.forecast import add_forecast
from pretouch_orchestrator.sessions.progress import Assessment
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.sessions.told import complete_from_gateway, complete_with_rest
from pretouch_orchestrator.sessions.transitions import (
    apply_scan,
    choose_option,
    choose_unpredicted,
    drop_faulty_modules,
    get_pending_plan,
    inspect_submission,
    is_predicted,
    plan_nearby,
    plan_over_object,
    plan_scan,
    scan_from_submission,
    shortlist_options,
    skip_scan,
    update_regions,
    warn_of_contradiction,
    warn_of_faults,
)
from pretouch_orchestrator.upstream.interfaces import Detector, Gateway, Registrar

T = TypeVar("T")
_log = structlog.get_logger()
_MAX_REGIONS = 12
MAX_SAMPLES = 400_000
"""Samples of all scans of a session: those that one call to the registrar may hold."""


PredictPrior = Callable[[Pose, Array], AnyPrior | None]
"""The prior of a correction, or None for the default: of the believed base_T_camera, and of the mean (3,), m, in base,
of the object's cloud."""


class RunInThread(Protocol):
    """Runs `fn(*args)` off the event loop; `memory` is what it needs at its peak, in bytes."""

    async def __call__(self, fn: Callable[..., T], *args: Any, memory: int = 0) -> T: ...


async def run_here(fn: Callable[..., T], *args: Any, memory: int = 0) -> T:
    """Runs `fn(*args)` at once, in a program that has nothing else to do."""
    return fn(*args)


class _Registered(NamedTuple):
    """A scan without the samples of faulty modules, the estimate with it, and what is wrong with those, or ""."""

    scan: Scan
    estimate: Estimate
    faults: str


class Loop:
    """Advances sessions. It keeps no state: records are immutable, and each step returns a new one.

    Args:
        gateway: None where the orchestrator was started without one.
        run: runs the planning and perception of a step.
    """

    def __init__(
        self,
        detector: Detector,
        registrar: Registrar,
        gateway: Gateway | None = None,
        run: RunInThread = run_here,
    ) -> None:
        self._detector = detector
        self._registrar = registrar
        self._gateway = gateway
        self._run = run

    async def open(
        self,
        id: str,
        created: float,
        request: SessionRequest,
        depth: DepthImage,
        mask: NDArray[np.bool_] | None,
        predict: PredictPrior | None = None,
    ) -> Record:
        """A new session with its first scan planned; it may already have ended.

        Args:
            created: s since the Unix epoch.
            depth: the client's depth image, (h, w).
            mask: (h, w), True on the object; None: the object is segmented.
            predict: what is known of the camera: the prior where the request names none.

        Raises:
            InvalidInput: no depth, no object, no table, a mask or roi that does not fit, or what cannot be.
            PretouchError: what the detector or the registrar raised.
        """
        memory = estimate_preparation(depth.metres.size)
        scene, origin, warnings = await self._run(prepare_scene, request, depth, mask, memory=memory)
        if request.prior is None and predict is not None:
            request = replace(request, prior=await self._run(predict, request.base_T_camera, scene.centroid))
        step = round(request.camera.fx / scene.camera.fx)
        seed = zlib.crc32(scene.depth.metres.tobytes())
        proposer, proposed = await self._detector.propose(scene, request.proposer, request.sensor, seed)
        estimate = await self._run(from_prior, request.prior or Prior(), scene.cloud, request.tolerance.at)
        warnings += await self._run(check_symmetry, request.tolerance, scene, estimate)
        regions = tuple(
            Region(
                f"region-{k}",
                region.rectangle.scaled(step).shifted(*origin),
                region.confidence,
                estimate.expected_error,
            )
            for k, region in enumerate(proposed[:_MAX_REGIONS], start=1)
        )
        record = Record(id, created, request, scene, origin, proposer, regions, estimate, warnings=warnings)
        return await self._plan_or_end(record)

    async def advance(self, record: Record, scan_id: str, submission: Submission) -> Record:
        """The session after its planned scan was answered; `record` itself if `scan_id` was answered before.

        Samples of faulty modules are left out. A scan of which no sample is left still counts against the budget, and
        the estimate stays as it was except for its `sensor_problem`. If the next scan is no better, even one without a
        single return, the session ends: a third one would fail too. It fails if it has become too large to be sent.

        Raises:
            Conflict: the session has ended.
            NotFound: no such scan is planned.
            InvalidInput: the scan is empty, does not fit the sensor or cannot be of the plan; the session is unchanged.
            PretouchError: what the registrar or the gateway raised; the session is unchanged.
        """
        if scan_id in record.answered:
            return record
        try:
            return await self._advance(record, get_pending_plan(record, scan_id), submission)
        except RefusedForSize as error:
            return end_session(record, State.FAILED, problem(error))

    async def _advance(self, record: Record, plan: ScanPlan, submission: Submission) -> Record:
        if isinstance(submission, Skipped):
            return await self._plan_or_end(skip_scan(record, plan))
        if isinstance(submission, GatewaySpan):
            fetched = await self.fetch_samples(submission)
            submission = complete_from_gateway(record, submission, fetched)
        else:
            submission = complete_with_rest(record, submission)
        warnings = await self._run(inspect_submission, record, plan, submission)
        scan, estimate, faults = await self._register(record, submission)
        after = await self._run(apply_scan, record, plan, submission, scan, estimate)
        warnings += [*warn_of_faults(plan, faults), *warn_of_contradiction(record, estimate)]
        after = replace(after, warnings=merge_warnings(record.warnings, warnings))
        if record.estimate.sensor_problem and estimate.sensor_problem:
            return exhaust_session(after, Exhaustion.SENSOR)
        return await self._plan_or_end(after)

    async def assess(self, record: Record) -> Assessment:
        """What the session would be if its pending scan ended with the samples told so far.

        Raises:
            PretouchError: what the registrar raised.
        """
        estimate = (await self._register(record, record.told_samples)).estimate
        return Assessment.of(record, estimate)

    async def _register(self, record: Record, submission: RangeSamples | Points) -> _Registered:
        """Registers all scans, this one included, without the samples of faulty modules."""
        kept, faults = await self._run(drop_faulty_modules, record, submission)
        if faults and isinstance(kept, RangeSamples) and len(kept) == 0:
            return _Registered(Scan.concatenate([]), replace(record.estimate, sensor_problem=faults), faults)
        if faults:
            _log.warning("modules of the sensor are left out", session=record.id, problem=faults)
        scan = scan_from_submission(record, kept)
        if (count := sum(map(len, record.measured)) + len(scan)) > MAX_SAMPLES:
            raise TooLarge(
                f"With this scan the session would have {count} samples; the limit is {MAX_SAMPLES}.",
                "Thin out the scan, or open a new session with the present estimate.",
            )
        scans = replace(record, measured=(*record.measured, scan)).registrable_scans
        if not scans:
            return _Registered(scan, record.estimate, faults)
        request = record.request
        estimate = await self._registrar.register(
            record.scene, scans, record.prior, request.sensor, request.tolerance.at
        )
        return _Registered(scan, estimate, faults)

    async def fetch_samples(self, span: GatewaySpan) -> RangeSamples:
        """The gateway's samples of the span; raises what the gateway raised, and `Unavailable` where there is none."""
        if self._gateway is None:
            raise Unavailable(
                "This orchestrator has no sensor gateway.",
                "Send the samples themselves, or start it with PRETOUCH_ORCHESTRATOR_GATEWAY=host:port.",
            )
        return await self._gateway.get_samples(span)

    async def _plan_or_end(self, record: Record) -> Record:
        """Plans the session's next scan, or ends the session."""
        if has_converged(record):
            return end_session(record, State.CONVERGED)
        if record.budget_used.scans >= record.request.budget.scans:
            return exhaust_session(record, Exhaustion.SCANS)
        paths = await self._run(plan_over_object, record)
        affordable = await self._run(select_affordable, record, paths)
        options = await self._predict(record, affordable)
        record = update_regions(record, options)
        best = await self._choose(record, options)
        if best is not None:
            return add_forecast(plan_scan(record, best))
        if any(option.visible for option in options):
            return exhaust_session(record, Exhaustion.NOTHING_TO_GAIN)
        limit = Exhaustion.OUT_OF_RANGE if affordable else await self._run(find_limit, record, paths)
        return exhaust_session(record, limit)

    async def _choose(self, record: Record, options: Sequence[Option]) -> Option | None:
        """The scan to make next: one over the object that sees well, or one beside it, or one that sees enough."""
        if not is_predicted(record, options):
            return choose_unpredicted(record, options)
        best = None
        if record.request.planner is Planner.INFORMATION:
            best = await self._choose_carefully(record, [option for option in options if option.well_visible])
            if best is None and options:
                nearby = await self._predict(record, await self._run(plan_nearby, record))
                best = await self._choose_carefully(record, [option for option in nearby if option.well_visible])
        return best or await self._choose_carefully(record, [option for option in options if option.visible])

    async def _choose_carefully(self, record: Record, options: Sequence[Option]) -> Option | None:
        """The best of the options, after the best few are predicted alone, which the registrar does with more care."""
        alone = [option.alone() for option in shortlist_options(record, options)]
        careful = [option for option in await self._predict(record, alone) if option.visible]
        return choose_option(record, careful)

    async def _predict(self, record: Record, candidates: Sequence[CandidatePath]) -> list[Option]:
        """Every span of the candidates, with what its scan is predicted to bring."""
        if not candidates:
            return []
        request = record.request
        predicted = await self._registrar.predict(
            record.scene,
            record.registrable_scans,
            record.prior,
            request.sensor,
            [Candidate(candidate.path, candidate.spans) for candidate in candidates],
            request.tolerance.at,
        )
        modules = len(request.sensor.tip_T_module)
        confidences = {region.id: region.confidence for region in record.regions}
        return [
            Option(candidate, span, prediction, confidences.get(candidate.region_id or "", 0.0), modules)
            for candidate, predictions in zip(candidates, predicted, strict=True)
            for span, prediction in zip(candidate.spans, predictions, strict=True)
        ]
