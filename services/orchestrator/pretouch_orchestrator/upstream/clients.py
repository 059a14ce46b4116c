"""gRPC clients of the upstream services: detector, registrar and sensor gateway."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any
from weakref import WeakKeyDictionary

from pretouch.errors import Unavailable
from pretouch.estimate import Estimate, Prior
from pretouch.rectangle import ProposedRegion
from pretouch.scan_prediction import Candidate, Prediction
from pretouch.scene import Scene
from pretouch.session import GatewaySpan, Proposer
from pretouch.tof import RangeSamples, Scan, Sensor
from pretouch.v1 import common_pb2, detector_pb2, detector_pb2_grpc, registrar_pb2, registrar_pb2_grpc
from pretouch.v1 import sensor_gateway_pb2 as gateway_pb2
from pretouch.v1 import sensor_gateway_pb2_grpc as gateway_pb2_grpc
from pretouch.wire import common
from pretouch.wire.scan_prediction import candidate_to_proto, predictions_from_proto
from pretouch_orchestrator.upstream.connection import UpstreamConnection

_QUICK, _LONG = 10.0, 30.0
"""s: deadlines of a lookup and of a computation."""


class SceneMessages:
    """Caches each scene's message for as long as the scene exists."""

    def __init__(self) -> None:
        self._messages: WeakKeyDictionary[Scene, common_pb2.Scene] = WeakKeyDictionary()

    def pack(self, scene: Scene) -> common_pb2.Scene:
        message = self._messages.get(scene)
        if message is None:
            message = self._messages[scene] = common.scene_to_proto(scene)
        return message


class DetectorClient:
    """Implements `interfaces.Detector`."""

    def __init__(self, upstream: UpstreamConnection, scenes: SceneMessages) -> None:
        self._upstream = upstream
        self._stub: Any = detector_pb2_grpc.DetectorServiceStub(upstream.channel)
        self._scenes = scenes

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
            scene=self._scenes.pack(scene),
            proposer=proposer or "",
            sensor=common.sensor_to_proto(sensor),
            seed=seed,
        )
        answer = await self._upstream.call(self._stub.Propose, request, _LONG)
        regions = [
            ProposedRegion(common.rectangle_from_proto(region.rectangle), region.confidence)
            for region in answer.regions
        ]
        return Proposer(answer.proposer), regions

    async def _check_ready(self, proposer: Proposer) -> None:
        answer = await self._upstream.call(self._stub.ListProposers, detector_pb2.ListProposersRequest(), _QUICK)
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
    """Implements `interfaces.Registrar`."""

    def __init__(self, upstream: UpstreamConnection, scenes: SceneMessages) -> None:
        self._upstream = upstream
        self._stub: Any = registrar_pb2_grpc.RegistrarServiceStub(upstream.channel)
        self._scenes = scenes

    async def register(self, scene: Scene, scans: Sequence[Scan], prior: Prior, sensor: Sensor) -> Estimate:
        """See `interfaces.Registrar`."""
        request = registrar_pb2.RegisterRequest(
            scene=self._scenes.pack(scene),
            scans=[common.scan_to_proto(scan) for scan in scans],
            settings=_settings_to_proto(prior, sensor),
        )
        answer = await self._upstream.call(self._stub.Register, request, _LONG)
        return common.estimate_from_proto(answer.estimate)

    async def predict(
        self, scene: Scene, scans: Sequence[Scan], prior: Prior, sensor: Sensor, candidates: Sequence[Candidate]
    ) -> list[list[Prediction]]:
        """See `interfaces.Registrar`."""
        request = registrar_pb2.PredictScansRequest(
            scene=self._scenes.pack(scene),
            scans=[common.scan_to_proto(scan) for scan in scans],
            settings=_settings_to_proto(prior, sensor),
            candidates=[candidate_to_proto(candidate) for candidate in candidates],
        )
        answer = await self._upstream.call(self._stub.PredictScans, request, _LONG)
        return predictions_from_proto(answer, candidates)


def _settings_to_proto(prior: Prior, sensor: Sensor) -> registrar_pb2.RegistrationSettings:
    return registrar_pb2.RegistrationSettings(prior=common.prior_to_proto(prior), sensor=common.sensor_to_proto(sensor))


class GatewayClient:
    """Implements `interfaces.Gateway`."""

    def __init__(self, upstream: UpstreamConnection) -> None:
        self._upstream = upstream
        self._stub: Any = gateway_pb2_grpc.SensorGatewayServiceStub(upstream.channel)

    async def get_samples(self, span: GatewaySpan) -> RangeSamples:
        """See `interfaces.Gateway`."""
        # "from" is a Python keyword, so the fields are passed as a dictionary.
        fields: dict[str, Any] = {"device": span.device, "from": span.start, "to": span.end}
        answer = await self._upstream.call(self._stub.GetSamples, gateway_pb2.GetSamplesRequest(**fields), _QUICK)
        return common.samples_from_proto(answer.samples)
