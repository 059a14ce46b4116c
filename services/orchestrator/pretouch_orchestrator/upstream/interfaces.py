"""Interfaces of the upstream services that sessions use."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from pretouch.estimate import Estimate
from pretouch.geometry import Array
from pretouch.prior import AnyPrior
from pretouch.rectangle import ProposedRegion
from pretouch.scan_prediction import Candidate, Prediction
from pretouch.scene import Scene
from pretouch.session import GatewaySpan, Proposer
from pretouch.tof import RangeSamples, Scan, Sensor


class Detector(Protocol):
    """Proposes regions worth scanning."""

    async def propose(
        self, scene: Scene, proposer: Proposer | None, sensor: Sensor, seed: int
    ) -> tuple[Proposer, list[ProposedRegion]]:
        """The proposer used, and its regions, the best first; with `proposer` None the detector chooses one."""
        ...


class Registrar(Protocol):
    """Estimates the object's pose, and predicts what a scan would improve."""

    async def register(
        self, scene: Scene, scans: Sequence[Scan], prior: AnyPrior, sensor: Sensor, at: Array | None = None
    ) -> Estimate:
        """The estimate from all scans; its errors are those at `at` (k, 3), m, in base, as the camera puts them, or at
        the object's visible points.
        """
        ...

    async def predict(
        self,
        scene: Scene,
        scans: Sequence[Scan],
        prior: AnyPrior,
        sensor: Sensor,
        candidates: Sequence[Candidate],
        at: Array | None = None,
    ) -> list[list[Prediction]]:
        """For each candidate, what a scan of each of its pieces would leave, at `at` as above, and return."""
        ...


class Gateway(Protocol):
    """Serves what the finger measured."""

    async def get_samples(self, span: GatewaySpan) -> RangeSamples:
        """The fused samples of a span of time."""
        ...
