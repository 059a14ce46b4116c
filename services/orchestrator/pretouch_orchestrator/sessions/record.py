"""The record of one session: what the store keeps and the state machine updates."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from pretouch.estimate import Estimate
from pretouch.geometry import Array, Pose
from pretouch.prior import AnyPrior, Prior
from pretouch.rectangle import RotatedRectangle
from pretouch.scene import Scene
from pretouch.session import (
    BudgetUsed,
    Forecast,
    Proposer,
    Region,
    ScanPlan,
    ScanSummary,
    Session,
    SessionRequest,
    State,
)
from pretouch.session_warning import SessionWarning
from pretouch.tof import RangeSamples, Scan


@dataclass(frozen=True, eq=False)
class Record:
    """One session.

    Attributes:
        created: s since the Unix epoch.
        request: what the client asked for; its `prior` is the session's, whoever chose it, or None for the default.
        scene: the part of the client's view around the object, which the other services are sent; every `step`-th
            pixel of a large image.
        origin: first pixel (u0, v0) of `scene` in the client's image; `regions` are in the client's pixels.
        measured: the beams of each scan in `scans`, in the same order, without those of faulty modules.
        skipped: ids of regions that could not be reached.
        told: samples of `next_scan` that were told while the robot moves, in the order in which they were told.
        answered: ids of the scans that the client has submitted or skipped.
        reason: a problem document, set when the session is exhausted or failed.
        warnings: what is legal but odd about the input so far.
        forecast: of the scans from `next_scan` on; None without one.
        version: that of the state in the store from which the record was derived; 0: it was not stored yet.
    """

    id: str
    created: float
    request: SessionRequest
    scene: Scene
    origin: tuple[int, int]
    proposer: Proposer
    regions: tuple[Region, ...]
    estimate: Estimate
    state: State = State.AWAITING_SCAN
    next_scan: ScanPlan | None = None
    scans: tuple[ScanSummary, ...] = ()
    measured: tuple[Scan, ...] = ()
    skipped: tuple[str, ...] = ()
    told: tuple[RangeSamples, ...] = ()
    answered: tuple[str, ...] = ()
    budget_used: BudgetUsed = field(default_factory=BudgetUsed)
    reason: dict[str, Any] | None = None
    warnings: tuple[SessionWarning, ...] = ()
    forecast: Forecast | None = None
    version: int = 0

    @property
    def prior(self) -> AnyPrior:
        """What is believed before the first scan: fixed when the session is opened, and stored with the request."""
        return self.request.prior or Prior()

    @property
    def step(self) -> int:
        """Pixels of the client's image from one of the scene's to the next."""
        return round(self.request.camera.fx / self.scene.camera.fx)

    def to_scene(self, rectangle: RotatedRectangle) -> RotatedRectangle:
        """A rectangle of the client's image in the scene's pixels."""
        u0, v0 = self.origin
        return rectangle.shifted(-u0, -v0).scaled(1 / self.step)

    @property
    def registrable_scans(self) -> tuple[Scan, ...]:
        """The scans to register: those with samples, or none as long as not a single sample has returned.

        The misses of a sensor that has never returned a range would otherwise lower the finger onto a surface that it
        cannot see.
        """
        if not any(scan.returned.any() for scan in self.measured):
            return ()
        return tuple(scan for scan in self.measured if len(scan))

    @cached_property
    def told_samples(self) -> RangeSamples:
        """All samples that were told of `next_scan`, in the order of time."""
        return RangeSamples.merge(self.told)

    def with_told(self, samples: RangeSamples) -> Record:
        """The record after these samples of `next_scan` were told too; raises `TooLarge`."""
        return self._derived(RangeSamples.merge([self.told_samples, samples]), told=(*self.told, samples))

    def with_version(self, version: int) -> Record:
        """The same state as it is stored."""
        return self._derived(self.told_samples, version=version)

    def _derived(self, told_samples: RangeSamples, **changes: Any) -> Record:
        """A changed copy that need not merge anew, chunk by chunk, what is merged already."""
        record = replace(self, **changes)
        record.__dict__["told_samples"] = told_samples
        return record

    def corrected_cloud(self) -> Array:
        """(n, 3), m, in base: the object's points, corrected by the present estimate."""
        return np.asarray(self.estimate.base_T_correction.apply(self.scene.cloud), dtype=np.float64)

    def corrected_tolerance_points(self) -> Array:
        """(k, 3), m, in base: where the error counts, corrected by the present estimate."""
        at = self.request.tolerance.at
        if at is None:
            return self.corrected_cloud()
        return np.asarray(self.estimate.base_T_correction.apply(at), dtype=np.float64)

    def to_session(self) -> Session:
        """The session as its client sees it."""
        base_T_object: Pose | None = None
        if self.request.base_T_object is not None:
            base_T_object = self.estimate.base_T_correction @ self.request.base_T_object
        return Session(
            id=self.id,
            state=self.state,
            proposer=self.proposer,
            planner=self.request.planner,
            regions=self.regions,
            estimate=self.estimate,
            next_scan=self.next_scan,
            scans=self.scans,
            budget_used=self.budget_used,
            base_T_object=base_T_object,
            reason=self.reason,
            warnings=self.warnings,
            table=self.scene.table,
            created=self.created,
            forecast=self.forecast,
        )
