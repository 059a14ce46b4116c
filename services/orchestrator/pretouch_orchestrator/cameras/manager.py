"""The use cases of cameras that sessions name: what they start from, what they teach, and what is told of it."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Sequence
from typing import NamedTuple

from pretouch.calibrated_camera import CalibratedCamera, CalibrationDrift, CameraSummary
from pretouch.errors import PretouchError
from pretouch.serving import ServiceContext
from pretouch.session_warning import SessionWarning
from pretouch_orchestrator.calibration import Calibration
from pretouch_orchestrator.cameras.findings import (
    calibrate,
    describe_camera,
    describe_event,
    observe,
    predict_prior,
    summarize,
    warn_of_drift,
    warn_of_room,
)
from pretouch_orchestrator.sessions.loop import PredictPrior
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store.camera_sql import unknown_camera
from pretouch_orchestrator.store.protocol import (
    MAX_CAMERAS,
    CameraChanged,
    CameraEntry,
    CameraMemory,
    CameraUpdate,
    KeyedRequest,
    NewEvent,
    Store,
)

_KEPT = 64
"""Calibrations that are kept in memory."""
_NOT_EVALUATED = "It could not be evaluated."


class Knowledge(NamedTuple):
    """What a new session starts from.

    Attributes:
        predict: None where nothing is known of its camera, or it names none.
        warnings: what is odd about the camera.
    """

    predict: PredictPrior | None = None
    warnings: tuple[SessionWarning, ...] = ()


class Cameras:
    """Learns cameras from the sessions that name them.

    All that is known is in the store, and what follows from it is computed when it is needed, in the service's threads.
    So any number of sessions and orchestrators may use a camera at once. A defect of the estimator never stops a
    session: it starts from the default prior then, and does not count.
    """

    def __init__(self, store: Store, context: ServiceContext) -> None:
        self._store = store
        self._context = context
        self._calibrations: OrderedDict[tuple[str, ...], Calibration] = OrderedDict()
        metrics = context.metrics
        self._ended = metrics.counter(
            "camera_sessions", "Sessions that named a camera and came to an end.", ("state", "counts")
        )
        self._alarms = metrics.counter(
            "camera_alarms", "Sessions after which a camera was found to have moved.", ("state",)
        )

    async def recall(self, owner: str, camera_id: str | None) -> Knowledge:
        """What a new session with this camera starts from."""
        if camera_id is None:
            return Knowledge()
        memory = await self._store.load_camera(owner, camera_id)
        if memory is None:
            full = len(await self._store.list_cameras(owner)) >= MAX_CAMERAS
            return Knowledge(warnings=(warn_of_room(),) if full else ())
        warnings = tuple(warn_of_drift(camera_id, memory.summary.drift))
        try:
            calibration = await self._calibrate(memory.counted)
        except PretouchError:
            raise
        except Exception as error:
            self._context.log.error("a camera's calibration met a defect", camera=camera_id, exc_info=error)
            return Knowledge(warnings=warnings)
        return Knowledge(lambda base_T_camera, c: predict_prior(calibration, base_T_camera, c), warnings)

    async def create(self, owner: str, record: Record, events: Sequence[NewEvent], key: KeyedRequest | None) -> Record:
        """Stores a new session: see `Store.create`."""
        camera_id = record.request.camera_id
        if camera_id is None or not record.state.ended:
            return await self._store.create(owner, record, events, key)
        memory = await self._store.load_camera(owner, camera_id)
        drift = CalibrationDrift() if memory is None else memory.summary.drift
        update = CameraUpdate(observe(record, time.time()))  # without a scan it cannot count
        stored = await self._store.create(owner, record, _tell(events, camera_id, update.entry, drift), key, update)
        self._count(record, update.entry)
        return stored

    async def update(self, owner: str, before: Record, after: Record, events: Sequence[NewEvent], lease: str) -> Record:
        """Stores a step of a session, and, where it ends, what it teaches of its camera: see `Store.update`."""
        camera_id = after.request.camera_id
        if camera_id is None or before.state.ended or not after.state.ended:
            return await self._store.update(before, after, events, lease)
        while True:
            memory = await self._store.load_camera(owner, camera_id)
            if memory is None:  # forgotten, or one too many
                return await self._store.update(before, after, events, lease)
            update = await self._learn(camera_id, memory, after)
            before_it = memory.summary.drift
            drift = before_it if update.summary is None else update.summary.drift
            told = _tell(events, camera_id, update.entry, drift)
            try:
                stored = await self._store.update(before, after, told, lease, update)
            except CameraChanged:
                continue
            self._count(after, update.entry)
            self._sound(camera_id, before_it, drift)
            return stored

    async def list(self, owner: str) -> list[CameraSummary]:
        """The owner's cameras, in the order of their names."""
        return await self._store.list_cameras(owner)

    async def get(self, owner: str, camera_id: str) -> CalibratedCamera:
        """What is known of a camera; raises `NotFound`."""
        memory = await self._store.load_camera(owner, camera_id)
        if memory is None:
            raise unknown_camera(camera_id)
        calibration = await self._calibrate(memory.counted)
        return await self._context.run_briefly(describe_camera, camera_id, memory, calibration)

    async def forget(self, owner: str, camera_id: str) -> None:
        """Forgets what was learned of a camera; raises `NotFound`. Sessions under way with it no longer count."""
        await self._store.forget_camera(owner, camera_id)
        self._context.log.info("camera forgotten", camera=camera_id)

    async def _calibrate(self, entries: Sequence[CameraEntry]) -> Calibration:
        """What follows from these sessions, which is computed once for the same ones.

        A session ends once, so the last two name all before them.
        """
        key = tuple(entry.session_id for entry in entries[-2:])
        calibration = self._calibrations.pop(key, None)
        if calibration is None:
            calibration = await self._context.go_on_in_thread(calibrate, entries)
        self._calibrations[key] = calibration
        while len(self._calibrations) > _KEPT:
            self._calibrations.popitem(last=False)
        return calibration

    async def _learn(self, camera_id: str, memory: CameraMemory, record: Record) -> CameraUpdate:
        """What an ended session teaches of its camera."""
        at = time.time()
        try:
            entry = await self._context.go_on_in_thread(observe, record, at)
            if entry.reason:
                return CameraUpdate(entry)
            calibration = await self._calibrate((*memory.counted, entry))
        except PretouchError as error:
            reason: Exception = error
        except Exception as error:
            reason = error
        else:
            return CameraUpdate(entry, summarize(camera_id, memory.summary.sessions + 1, calibration), memory.last)
        self._context.log.error("a session could not be evaluated for its camera", camera=camera_id, exc_info=reason)
        return CameraUpdate(CameraEntry(record.id, at, _NOT_EVALUATED))

    def _count(self, record: Record, entry: CameraEntry) -> None:
        self._ended.labels(record.state.value, "no" if entry.reason else "yes").inc()

    def _sound(self, camera_id: str, before: CalibrationDrift, after: CalibrationDrift) -> None:
        """The alarm, where the camera is no longer where it was."""
        if after != before and after.state == "moved":
            self._alarms.labels(after.state).inc()
            self._context.log.warning("a camera has moved", camera=camera_id, since=after.since)


def _tell(events: Sequence[NewEvent], camera_id: str, entry: CameraEntry, drift: CalibrationDrift) -> list[NewEvent]:
    """The events of a step that ends a session, with the camera's before the `end`."""
    told = NewEvent("camera", describe_event(camera_id, entry, drift))
    return [*(event for event in events if event.type != "end"), told, *(e for e in events if e.type == "end")]
