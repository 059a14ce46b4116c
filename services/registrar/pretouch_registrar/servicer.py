"""The registrar over gRPC: decodes requests, computes in threads, encodes responses."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from typing import TypeVar

import grpc
from google.protobuf.message import DecodeError

from pretouch.errors import InvalidInput, Malformed, TooLarge
from pretouch.geometry import Array
from pretouch.prior import Prior
from pretouch.scene import Scene
from pretouch.serving import ServiceContext
from pretouch.session import Tolerance
from pretouch.tof import Scan
from pretouch.v1 import common_pb2, registrar_pb2_grpc
from pretouch.v1 import registrar_pb2 as pb
from pretouch.wire.common import (
    array_from_proto,
    estimate_to_proto,
    mesh_from_proto,
    prior_from_proto,
    scan_from_proto,
    scene_from_proto,
    sensor_from_proto,
)
from pretouch.wire.scan_prediction import candidate_from_proto, predictions_to_proto
from pretouch_registrar.engines import Engine
from pretouch_registrar.mesh_scene import mesh_scene
from pretouch_registrar.needs import BASE, BYTE_OF_TARGET, Request, estimate_memory, estimate_work
from pretouch_registrar.registration import Registrar, Settings, check_samples

MAX_TARGET_BYTES = 32 * 2**20
MAX_STREAM_SCANS = 1000
Asked = TypeVar("Asked", pb.RegisterRequest, pb.PredictScansRequest)
Answer = TypeVar("Answer")
_STREAM_ORDER = "Send the header first, then the target's chunks until scene_bytes or mesh_bytes are there, then scans."


def settings_from_proto(message: pb.RegistrationSettings, default: Engine) -> Settings:
    """Raises InvalidInput for an unknown engine."""
    try:
        engine = Engine(message.engine) if message.engine else default
    except ValueError:
        known = ", ".join(engine.value for engine in Engine)
        raise InvalidInput(f"There is no engine {message.engine!r}.", f"Choose one of {known}.") from None
    return Settings(engine, prior_from_proto(message) or Prior(), sensor_from_proto(message.sensor))


def points_from_proto(message: pb.RegistrationSettings) -> Array | None:
    """(k, 3), m: where errors count, if the settings say it; raises InvalidInput for too many points or none."""
    if not message.HasField("at"):
        return None
    return Tolerance(at=array_from_proto(message.at, "settings.at")).at


@dataclass
class RegistrarServicer(registrar_pb2_grpc.RegistrarServiceServicer):
    """Serves `Register`, `RegisterStream` and `PredictScans`; `default` is the engine for requests that name none."""

    context: ServiceContext
    registrar: Registrar
    default: Engine

    async def Register(self, request: pb.RegisterRequest, context: grpc.aio.ServicerContext) -> pb.RegisterResponse:
        return await self._run(self._register, request)

    def _register(self, request: pb.RegisterRequest) -> pb.RegisterResponse:
        scans = [scan_from_proto(scan) for scan in request.scans]
        settings = settings_from_proto(request.settings, self.default)
        at = points_from_proto(request.settings)
        estimate = self.registrar.register(self._read_target(request), scans, settings, at)
        return pb.RegisterResponse(estimate=estimate_to_proto(estimate))

    async def PredictScans(
        self, request: pb.PredictScansRequest, context: grpc.aio.ServicerContext
    ) -> pb.PredictScansResponse:
        return await self._run(self._predict, request)

    async def _run(self, compute: Callable[[Asked], Answer], request: Asked) -> Answer:
        known = None
        if request.WhichOneof("target") == "scene_digest":
            known = self.registrar.recall(request.scene_digest)  # one that is not known is asked for at once
        return await self.context.run_in_thread(compute, request, memory=estimate_memory(request, known))

    def _predict(self, request: pb.PredictScansRequest) -> pb.PredictScansResponse:
        scans = [scan_from_proto(scan) for scan in request.scans]
        candidates = [candidate_from_proto(candidate) for candidate in request.candidates]
        settings = settings_from_proto(request.settings, self.default)
        at = points_from_proto(request.settings)
        return predictions_to_proto(self.registrar.predict(self._read_target(request), scans, settings, candidates, at))

    def _read_target(self, request: Request) -> Scene:
        match request.WhichOneof("target"):
            case "mesh":
                return mesh_scene(mesh_from_proto(request.mesh))
            case "scene_digest":
                return self.registrar.recall(request.scene_digest)
            case _:
                return scene_from_proto(request.scene)

    async def RegisterStream(
        self, request_iterator: AsyncIterator[pb.RegisterStreamRequest], context: grpc.aio.ServicerContext
    ) -> AsyncIterator[pb.RegisterStreamResponse]:
        steps = aiter(request_iterator)
        first = await anext(steps, None)
        if first is None or first.WhichOneof("step") != "header":
            raise InvalidInput("The stream does not begin with a header.", _STREAM_ORDER)
        settings = settings_from_proto(first.header.settings, self.default)
        at = points_from_proto(first.header.settings)
        header = first.header
        read = _decode_mesh if header.WhichOneof("target") == "mesh_bytes" else self._decode_scene
        size = header.mesh_bytes or header.scene_bytes
        data = await _collect(steps, size)
        scene = await self.context.run_in_thread(read, data, memory=BASE + BYTE_OF_TARGET * size)
        del data
        scans: list[Scan] = []
        async for step in steps:
            if step.WhichOneof("step") != "scan":
                raise InvalidInput("The target is complete, but no scan came next.", _STREAM_ORDER)
            if len(scans) == MAX_STREAM_SCANS:
                raise TooLarge(f"More than {MAX_STREAM_SCANS} scans came on one stream.", "Open a new stream.")
            scans.append(scan_from_proto(step.scan))
            check_samples(scans)
            memory = estimate_work(scene.mask.size, sum(map(len, scans)))
            estimate = await self.context.run_in_thread(
                self.registrar.register, scene, tuple(scans), settings, at, memory=memory
            )
            yield pb.RegisterStreamResponse(estimate=estimate_to_proto(estimate))

    def _decode_scene(self, data: bytes) -> Scene:
        try:
            return self.registrar.remember(scene_from_proto(common_pb2.Scene.FromString(data)))
        except DecodeError:
            raise Malformed("The scene's bytes are not a pretouch.v1.Scene.", "Send the serialised message.") from None


async def _collect(steps: AsyncIterator[pb.RegisterStreamRequest], size: int) -> bytes:
    if size > MAX_TARGET_BYTES:
        raise TooLarge(
            f"The target has {size} bytes; the limit is {MAX_TARGET_BYTES}.",
            "Crop the depth image, or simplify the mesh.",
        )
    data = bytearray()
    while len(data) < size:
        step = await anext(steps, None)
        if step is None or step.WhichOneof("step") != "scene_chunk":
            raise InvalidInput(f"The target ends after {len(data)} of {size} bytes.", _STREAM_ORDER)
        data += step.scene_chunk
    if len(data) > size:
        raise InvalidInput(f"The target has {len(data)} bytes, not the {size} announced.", _STREAM_ORDER)
    return bytes(data)


def _decode_mesh(data: bytes) -> Scene:
    try:
        return mesh_scene(mesh_from_proto(common_pb2.MeshTarget.FromString(data)))
    except DecodeError:
        raise Malformed("The mesh's bytes are not a pretouch.v1.MeshTarget.", "Send the serialised message.") from None
