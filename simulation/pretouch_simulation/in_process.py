"""The session's ports answered by the services' own code in this process, without a network."""

from __future__ import annotations

from collections.abc import Sequence

from pretouch_detector.proposals import propose
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar, Settings

from pretouch.estimate import Estimate
from pretouch.geometry import Array
from pretouch.prior import AnyPrior
from pretouch.rectangle import ProposedRegion
from pretouch.scan_prediction import Candidate, Prediction
from pretouch.scene import Scene
from pretouch.session import Proposer
from pretouch.tof import Scan, Sensor

_REGIONS = 20


class InProcessDetector:
    """The detector's proposers."""

    async def propose(
        self, scene: Scene, proposer: Proposer | None, sensor: Sensor, seed: int
    ) -> tuple[Proposer, list[ProposedRegion]]:
        """See `upstream.interfaces.Detector`."""
        proposals = propose(scene, proposer, sensor, _REGIONS, seed)
        return proposals.proposer, list(proposals.regions)


class InProcessRegistrar:
    """The registrar's `engine`; sessions may share a registrar."""

    def __init__(self, engine: Engine, registrar: Registrar) -> None:
        self._engine, self._registrar = engine, registrar

    async def register(
        self, scene: Scene, scans: Sequence[Scan], prior: AnyPrior, sensor: Sensor, at: Array | None = None
    ) -> Estimate:
        """See `upstream.interfaces.Registrar`."""
        return self._registrar.register(scene, scans, Settings(self._engine, prior, sensor), at)

    async def predict(
        self,
        scene: Scene,
        scans: Sequence[Scan],
        prior: AnyPrior,
        sensor: Sensor,
        candidates: Sequence[Candidate],
        at: Array | None = None,
    ) -> list[list[Prediction]]:
        """See `upstream.interfaces.Registrar`."""
        return self._registrar.predict(scene, scans, Settings(self._engine, prior, sensor), candidates, at)
