"""The detector over gRPC: decodes requests, computes in threads, encodes responses."""

from __future__ import annotations

from dataclasses import dataclass

import grpc.aio

from pretouch.errors import InvalidInput
from pretouch.serving import ServiceContext
from pretouch.session import Proposer
from pretouch.v1 import detector_pb2 as pb
from pretouch.v1 import detector_pb2_grpc
from pretouch.wire.common import rectangle_to_proto, scene_from_proto, sensor_from_proto
from pretouch_detector.proposals import list_readiness, propose

DEFAULT_COUNT = 20
_BASE, _BYTE_OF_SCENE = 48 * 2**20, 8
"""Memory for a proposal, and for each byte of a scene's message: half as much again as was measured."""


@dataclass
class DetectorServicer(detector_pb2_grpc.DetectorServiceServicer):
    """Serves `Propose` and `ListProposers`."""

    context: ServiceContext

    async def Propose(
        self, request: pb.ProposeRequest, context: grpc.aio.ServicerContext[pb.ProposeRequest, pb.ProposeResponse]
    ) -> pb.ProposeResponse:
        memory = _BASE + _BYTE_OF_SCENE * request.scene.ByteSize()
        return await self.context.run_in_thread(_propose, request, memory=memory)

    async def ListProposers(
        self,
        request: pb.ListProposersRequest,
        context: grpc.aio.ServicerContext[pb.ListProposersRequest, pb.ListProposersResponse],
    ) -> pb.ListProposersResponse:
        infos = [pb.ProposerInfo(name=name, ready=not reason, reason=reason) for name, reason in list_readiness()]
        return pb.ListProposersResponse(proposers=infos)


def _propose(request: pb.ProposeRequest) -> pb.ProposeResponse:
    if request.proposer and request.proposer not in set(Proposer):
        raise InvalidInput(f"There is no proposer {request.proposer!r}.", f"Choose one of {', '.join(Proposer)}.")
    proposals = propose(
        scene_from_proto(request.scene),
        Proposer(request.proposer) if request.proposer else None,
        sensor_from_proto(request.sensor),
        request.count or DEFAULT_COUNT,
        request.seed,
    )
    regions = [
        pb.ProposedRegion(rectangle=rectangle_to_proto(region.rectangle), confidence=region.confidence)
        for region in proposals.regions
    ]
    return pb.ProposeResponse(regions=regions, proposer=proposals.proposer)
