"""gRPC clients of the upstream services: detector, registrar and sensor gateway."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from pretouch.errors import Unavailable, UnknownScene
from pretouch.estimate import Estimate
from pretouch.geometry import Array
from pretouch.prior import AnyPrior
from pretouch.rectangle import ProposedRegion
from pretouch.scan_prediction import Candidate, Prediction
from pretouch.scene import Scene
from pretouch.session import GatewaySpan, Proposer
from pretouch.tof import RangeSamples, Scan, Sensor
from pretouch.v1 import detector_pb2, registrar_pb2
from pretouch.v1 import sensor_gateway_pb2 as gateway_pb2
from pretouch.wire import common
from pretouch.wire.registration import settings_to_proto
from pretouch.wire.scan_prediction import candidate_to_proto, predictions_from_proto
from pretouch_orchestrator.upstream.copies import Copies

_QUICK, _LONG = 10.0, 30.0
"""s: deadlines of a lookup and of a computation."""


class DetectorClient:
    """Implements `interfaces.Detector`."""

    def __init__(self, copies: Copies) -> None:
        self._copies = copies

    async def propose(
        self, scene: Scene, proposer: Proposer | None, sensor: Sensor, seed: int
    ) -> tuple[Proposer, list[ProposedRegion]]:
        """See `interfaces.Detector`.

        Raises:
            Unavailable: `proposer` is not ready; the detail names those that are.
        """
        if proposer is not None:
            await self._check_ready(proposer)
        request = detector_pb2.ProposeRequest(
            scene=common.scene_to_proto(scene),
            proposer=proposer or "",
            sensor=common.sensor_to_proto(sensor),
            seed=seed,
        )
        answer = await self._copies.call("Propose", request, _LONG)
        regions = [
            ProposedRegion(common.rectangle_from_proto(region.rectangle), region.confidence)
            for region in answer.regions
        ]
        return Proposer(answer.proposer), regions

    async def _check_ready(self, proposer: Proposer) -> None:
        answer = await self._copies.call("ListProposers", detector_pb2.ListProposersRequest(), _QUICK)
        ready = [info.name for info in answer.proposers if info.ready]
        if proposer not in ready:
            reasons = [info.reason for info in answer.proposers if info.name == proposer and info.reason]
            raise Unavailable(
                f"The proposer {proposer.value!r} is not ready{''.join(f': {reason}' for reason in reasons)}. "
                f"Ready: {', '.join(ready) or 'none'}.",
                "Choose one that is ready, or leave out `proposer` to use the best of them.",
                retry_after=math.inf,
            )


class RegistrarClient:
    """Implements `interfaces.Registrar`. A scene's calls go to the same copy, which is sent the scene once."""

    def __init__(self, copies: Copies) -> None:
        self._copies = copies

    async def register(
        self, scene: Scene, scans: Sequence[Scan], prior: AnyPrior, sensor: Sensor, at: Array | None = None
    ) -> Estimate:
        """See `interfaces.Registrar`."""
        request = registrar_pb2.RegisterRequest(
            scene_digest=scene.digest,
            scans=[common.scan_to_proto(scan) for scan in scans],
            settings=settings_to_proto(prior, sensor, at),
        )
        answer = await self._ask("Register", request, scene)
        return common.estimate_from_proto(answer.estimate)

    async def predict(
        self,
        scene: Scene,
        scans: Sequence[Scan],
        prior: AnyPrior,
        sensor: Sensor,
        candidates: Sequence[Candidate],
        at: Array | None = None,
    ) -> list[list[Prediction]]:
        """See `interfaces.Registrar`."""
        request = registrar_pb2.PredictScansRequest(
            scene_digest=scene.digest,
            scans=[common.scan_to_proto(scan) for scan in scans],
            settings=settings_to_proto(prior, sensor, at),
            candidates=[candidate_to_proto(candidate) for candidate in candidates],
        )
        return predictions_from_proto(await self._ask("PredictScans", request, scene), candidates)

    async def _ask(
        self, method: str, request: registrar_pb2.RegisterRequest | registrar_pb2.PredictScansRequest, scene: Scene
    ) -> Any:
        try:
            return await self._copies.call(method, request, _LONG, scene.digest)
        except UnknownScene:
            request.scene.CopyFrom(common.scene_to_proto(scene))
            return await self._copies.call(method, request, _LONG, scene.digest)


class GatewayClient:
    """Implements `interfaces.Gateway`."""

    def __init__(self, copies: Copies) -> None:
        self._copies = copies

    async def get_samples(self, span: GatewaySpan) -> RangeSamples:
        """See `interfaces.Gateway`."""
        # "from" is a Python keyword, so the fields are passed as a dictionary.
        fields: dict[str, Any] = {"device": span.device, "from": span.start, "to": span.end}
        answer = await self._copies.call("GetSamples", gateway_pb2.GetSamplesRequest(**fields), _QUICK)
        return common.samples_from_proto(answer.samples)
