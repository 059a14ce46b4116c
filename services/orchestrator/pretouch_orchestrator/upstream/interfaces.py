"""What a session needs from the other services, however they are reached."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from pretouch.estimate import Estimate, Prior
from pretouch.rectangle import RotatedRectangle
from pretouch.scene import Scene
from pretouch.session import GatewaySpan, Proposer
from pretouch.tof import RangeSamples, Scan, Sensor
from pretouch.trajectory import Trajectory


@dataclass(frozen=True)
class ProposedRegion:
    """A rectangle in the scene's pixels and the proposer's score in [0, 1]."""

    rectangle: RotatedRectangle
    confidence: float


class Detector(Protocol):
    """Where is it worth looking?"""

    async def propose(
        self, scene: Scene, proposer: Proposer | None, sensor: Sensor, seed: int
    ) -> tuple[Proposer, list[ProposedRegion]]:
        """Regions, the best first, and the proposer used; `proposer` None lets the detector choose."""
        ...


class Registrar(Protocol):
    """Where is the object, and what would a scan tell?"""

    async def register(self, scene: Scene, scans: Sequence[Scan], prior: Prior, sensor: Sensor) -> Estimate:
        """The estimate from all scans."""
        ...

    async def predict(
        self, scene: Scene, scans: Sequence[Scan], prior: Prior, sensor: Sensor, candidates: Sequence[Trajectory]
    ) -> list[float]:
        """m, for each candidate: the expected error after it."""
        ...


class Gateway(Protocol):
    """What did the finger measure?"""

    async def samples(self, span: GatewaySpan) -> RangeSamples:
        """The fused samples of a span of time."""
        ...
