"""A session from its opening to its end: what is computed here, what is asked of the other services, in which order."""

from __future__ import annotations

import asyncio
import zlib
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pretouch.camera import DepthImage
from pretouch.errors import PretouchError, problem
from pretouch.estimate import from_prior
from pretouch.exhaustion import Exhaustion
from pretouch.scene import Scene
from pretouch.session import Points, Region, ScanPlan, SessionRequest, Skipped, State
from pretouch.tof import RangeSamples, Scan
from pretouch.trajectory import Trajectory
from pretouch_orchestrator.perception.clusters import specks
from pretouch_orchestrator.perception.segmentation import find_object
from pretouch_orchestrator.planning.envelope import SAFE, Margins
from pretouch_orchestrator.planning.path import plan_paths
from pretouch_orchestrator.sessions.budget import affordable, limit_of
from pretouch_orchestrator.sessions.endings import ended, exhausted, has_converged
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.sessions.transitions import (
    awaited,
    checked,
    measured,
    open_regions,
    passed_over,
    planned,
    used,
)
from pretouch_orchestrator.upstream.interfaces import Detector, Registrar

_MARGIN = 0.08
"""m around the object that the services get to see, besides three standard deviations of the prior."""
_MAX_REGIONS = 20


class Loop:
    """Drives sessions; holds none. Records are never changed: each step answers a new one.

    Args:
        margins: how far planned paths keep from what the estimate leaves uncertain.
    """

    def __init__(self, detector: Detector, registrar: Registrar, margins: Margins = SAFE) -> None:
        self._detector = detector
        self._registrar = registrar
        self._margins = margins

    async def open(
        self, id: str, created: float, request: SessionRequest, depth: DepthImage, mask: NDArray[np.bool_] | None
    ) -> Record:
        """A new session with its first scan planned; it may have ended already.

        Args:
            created: s since the Unix epoch.
            depth: the client's depth image, (h, w).
            mask: (h, w), True on the object; None: it is looked for.

        Raises:
            InvalidInput: no depth, no object, no table, or a mask or roi that does not fit.
            PretouchError: what detector or registrar raised.
        """
        scene, origin = await asyncio.to_thread(viewed, request, depth, mask)
        seed = zlib.crc32(scene.depth.metres.tobytes())
        proposer, proposed = await self._detector.propose(scene, request.proposer, request.sensor, seed)
        estimate = await asyncio.to_thread(from_prior, request.prior, scene.cloud)
        regions = tuple(
            Region(f"region-{k}", region.rectangle.shifted(*origin), region.confidence, estimate.expected_error)
            for k, region in enumerate(proposed[:_MAX_REGIONS], start=1)
        )
        return await self._go_on(Record(id, created, request, scene, origin, proposer, regions, estimate))

    def check(self, record: Record, scan_id: str) -> ScanPlan:
        """The plan that waits for `scan_id`.

        Raises:
            Conflict: the session has ended.
            NotFound: no such scan is planned.
        """
        return awaited(record, scan_id)

    async def advance(self, record: Record, scan_id: str, submission: RangeSamples | Points | Skipped) -> Record:
        """The session after its planned scan was answered; as it is if `scan_id` was answered before.

        What modules sent that measured nothing is left out. A scan of which nothing is left costs its budget and leaves
        the estimate as it was, but for its `sensor_problem`; another one that tells nothing, misses alone too, ends the
        session: the third would be no better.

        Raises:
            Conflict: the session has ended.
            NotFound: no such scan is planned.
            InvalidInput: the scan is empty or does not fit the sensor; the session is as it was.
            PretouchError: what the registrar raised; the session is as it was.
        """
        if scan_id in record.answered:
            return record
        plan = awaited(record, scan_id)
        if isinstance(submission, Skipped):
            return await self._go_on(passed_over(record, plan))
        believed, sensor_problem = await asyncio.to_thread(checked, record, submission)
        scan = Scan.concatenate([]) if sensor_problem else measured(record, believed)
        request, evidence = record.request, replace(record, measured=(*record.measured, scan)).evidence
        if sensor_problem:
            estimate = replace(record.estimate, sensor_problem=sensor_problem)
        elif evidence:
            estimate = await self._registrar.register(record.scene, evidence, request.prior, request.sensor)
        else:
            estimate = record.estimate
        after = await asyncio.to_thread(used, record, plan, submission, scan, estimate)
        if record.estimate.sensor_problem and estimate.sensor_problem:
            return exhausted(after, Exhaustion.SENSOR)
        return await self._go_on(after)

    def cancel(self, record: Record) -> Record:
        """The session, cancelled unless it has ended."""
        return ended(record, State.CANCELLED)

    def fail(self, record: Record, error: PretouchError) -> Record:
        """The session, failed for `error` unless it has ended."""
        return ended(record, State.FAILED, problem(error))

    async def _go_on(self, record: Record) -> Record:
        """Ends the session or plans its next scan."""
        if has_converged(record):
            return ended(record, State.CONVERGED)
        paths = await asyncio.to_thread(_paths, record, self._margins)
        candidates = await asyncio.to_thread(affordable, record, paths)
        if not candidates:
            return exhausted(record, await asyncio.to_thread(limit_of, record, paths))
        request = record.request
        expected_errors = await self._registrar.predict(
            record.scene, record.evidence, request.prior, request.sensor, [path for _, path, _ in candidates]
        )
        return planned(record, candidates, expected_errors)


def viewed(request: SessionRequest, depth: DepthImage, mask: NDArray[np.bool_] | None) -> tuple[Scene, tuple[int, int]]:
    """The part of the client's view that matters, without specks in mid-air, and its first pixel (u0, v0)."""
    whole = find_object(depth, request.camera, request.base_T_camera, request.roi, mask, request.table)
    prior = request.prior
    scene, origin = whole.cropped(
        _MARGIN + 3 * float(np.hypot(prior.translation_std, prior.rotation_std * whole.radius))
    )
    metres = scene.depth.metres
    believed = np.where(specks(metres, scene.camera.fx) & ~scene.mask, 0, metres)
    return replace(scene, depth=DepthImage(believed)), origin


def _paths(record: Record, margins: Margins) -> dict[str, Trajectory]:
    """By region id: the paths of the open regions whose perimeter comes over the object."""
    regions = open_regions(record)
    u0, v0 = record.origin
    rectangles = [region.rectangle.shifted(-u0, -v0) for region in regions]
    settings = record.request.scan
    paths = plan_paths(record.scene, rectangles, record.estimate, settings, margins) if regions else []
    return {region.id: path for region, path in zip(regions, paths, strict=True) if path is not None}
