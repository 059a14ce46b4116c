"""The closed loop of a session: perceive, plan, scan, register, until it ends."""

from __future__ import annotations

import asyncio
import zlib
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pretouch.camera import DepthImage
from pretouch.errors import InvalidInput, Unavailable
from pretouch.estimate import from_prior
from pretouch.exhaustion import Exhaustion
from pretouch.scene import Scene
from pretouch.session import GatewaySpan, Region, SessionRequest, Skipped, State, Submission
from pretouch.tof import RangeSamples, Scan
from pretouch.trajectory import Trajectory
from pretouch_orchestrator.perception.clusters import find_specks
from pretouch_orchestrator.perception.segmentation import find_object
from pretouch_orchestrator.planning.path import plan_paths
from pretouch_orchestrator.planning.tip_floor import SAFE, Margins
from pretouch_orchestrator.sessions.budget import find_limit, select_affordable
from pretouch_orchestrator.sessions.endings import end_session, exhaust_session, has_converged
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.sessions.transitions import (
    apply_scan,
    drop_faulty_modules,
    get_pending_plan,
    list_open_regions,
    plan_next,
    scan_from_submission,
    skip_scan,
)
from pretouch_orchestrator.upstream.interfaces import Detector, Gateway, Registrar

_CROP_MARGIN = 0.08
"""m around the object that the crop keeps, besides three standard deviations of the prior."""
_MAX_REGIONS = 20


class Loop:
    """Advances sessions. It keeps no state: records are immutable, and each step returns a new one.

    Args:
        margins: the distance that planned paths keep from the surface.
        gateway: None where the orchestrator was started without one.
    """

    def __init__(
        self, detector: Detector, registrar: Registrar, margins: Margins = SAFE, gateway: Gateway | None = None
    ) -> None:
        self._detector = detector
        self._registrar = registrar
        self._margins = margins
        self._gateway = gateway

    async def open(
        self, id: str, created: float, request: SessionRequest, depth: DepthImage, mask: NDArray[np.bool_] | None
    ) -> Record:
        """A new session with its first scan planned; it may already have ended.

        Args:
            created: s since the Unix epoch.
            depth: the client's depth image, (h, w).
            mask: (h, w), True on the object; None: the object is segmented.

        Raises:
            InvalidInput: no depth, no object, no table, or a mask or roi that does not fit.
            PretouchError: what the detector or the registrar raised.
        """
        scene, origin = await asyncio.to_thread(prepare_scene, request, depth, mask)
        seed = zlib.crc32(scene.depth.metres.tobytes())
        proposer, proposed = await self._detector.propose(scene, request.proposer, request.sensor, seed)
        estimate = await asyncio.to_thread(from_prior, request.prior, scene.cloud)
        regions = tuple(
            Region(f"region-{k}", region.rectangle.shifted(*origin), region.confidence, estimate.expected_error)
            for k, region in enumerate(proposed[:_MAX_REGIONS], start=1)
        )
        return await self._plan_or_end(Record(id, created, request, scene, origin, proposer, regions, estimate))

    async def advance(self, record: Record, scan_id: str, submission: Submission) -> Record:
        """The session after its planned scan was answered; `record` itself if `scan_id` was answered before.

        Samples of faulty modules are left out. A scan of which no sample is left still counts against the budget, and
        the estimate stays as it was except for its `sensor_problem`. If the next scan is no better, even one without a
        single return, the session ends: a third one would fail too.

        Raises:
            Conflict: the session has ended.
            NotFound: no such scan is planned.
            InvalidInput: the scan is empty or does not fit the sensor; the session is unchanged.
            PretouchError: what the registrar or the gateway raised; the session is unchanged.
        """
        if scan_id in record.answered:
            return record
        plan = get_pending_plan(record, scan_id)
        if isinstance(submission, Skipped):
            return await self._plan_or_end(skip_scan(record, plan))
        if isinstance(submission, GatewaySpan):
            submission = await self._fetch_samples(submission)
        kept, sensor_problem = await asyncio.to_thread(drop_faulty_modules, record, submission)
        scan = Scan.concatenate([]) if sensor_problem else scan_from_submission(record, kept)
        request = record.request
        scans = replace(record, measured=(*record.measured, scan)).registrable_scans
        if sensor_problem:
            estimate = replace(record.estimate, sensor_problem=sensor_problem)
        elif scans:
            estimate = await self._registrar.register(record.scene, scans, request.prior, request.sensor)
        else:
            estimate = record.estimate
        after = await asyncio.to_thread(apply_scan, record, plan, submission, scan, estimate)
        if record.estimate.sensor_problem and estimate.sensor_problem:
            return exhaust_session(after, Exhaustion.SENSOR)
        return await self._plan_or_end(after)

    async def _fetch_samples(self, span: GatewaySpan) -> RangeSamples:
        if self._gateway is None:
            raise Unavailable(
                "This orchestrator has no sensor gateway.",
                "Send the samples themselves, or start it with PRETOUCH_ORCHESTRATOR_GATEWAY=host:port.",
            )
        samples = await self._gateway.get_samples(span)
        if len(samples) == 0:
            raise InvalidInput(
                f"The gateway has no samples from {span.start:.6f} to {span.end:.6f} s.",
                "Give a span, by the clock of the gateway's host, during which the gateway was sent tip poses.",
            )
        return samples

    async def _plan_or_end(self, record: Record) -> Record:
        """Plans the session's next scan, or ends the session."""
        if has_converged(record):
            return end_session(record, State.CONVERGED)
        paths = await asyncio.to_thread(_plan_open_paths, record, self._margins)
        affordable = await asyncio.to_thread(select_affordable, record, paths)
        if not affordable:
            return exhaust_session(record, await asyncio.to_thread(find_limit, record, paths))
        request = record.request
        expected_errors = await self._registrar.predict(
            record.scene,
            record.registrable_scans,
            request.prior,
            request.sensor,
            [option.path for option in affordable],
        )
        return plan_next(record, affordable, expected_errors)


def prepare_scene(
    request: SessionRequest, depth: DepthImage, mask: NDArray[np.bool_] | None
) -> tuple[Scene, tuple[int, int]]:
    """The client's view cropped to the object's surroundings, without specks, and the crop's first pixel (u0, v0)."""
    whole = find_object(depth, request.camera, request.base_T_camera, request.roi, mask, request.table)
    prior = request.prior
    scene, origin = whole.cropped(
        _CROP_MARGIN + 3 * float(np.hypot(prior.translation_std, prior.rotation_std * whole.radius))
    )
    metres = scene.depth.metres
    cleaned = np.where(find_specks(metres, scene.camera.fx) & ~scene.mask, 0, metres)
    return replace(scene, depth=DepthImage(cleaned)), origin


def _plan_open_paths(record: Record, margins: Margins) -> dict[str, Trajectory]:
    """By region id: the paths of the open regions whose perimeter crosses the object."""
    regions = list_open_regions(record)
    u0, v0 = record.origin
    rectangles = [region.rectangle.shifted(-u0, -v0) for region in regions]
    settings = record.request.scan
    paths = plan_paths(record.scene, rectangles, record.estimate, settings, margins) if regions else []
    return {region.id: path for region, path in zip(regions, paths, strict=True) if path is not None}
