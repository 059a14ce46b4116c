"""Detector, registrar and gateway in one gRPC server: quick, deterministic, with faults on demand.

    with FakeUpstream() as upstream:
        ...                                    # the orchestrator is given upstream.address three times
        upstream.ready = {"random"}            # proposers that can be used
        upstream.fail("Register", Unavailable("gone", "wait"), times=2)
        with upstream.held("Register"):        # calls wait until the block ends
            ...
        with upstream.estimating(doubtful):    # estimates from scans are changed by a function until the block ends
            ...
        upstream.calls                         # what was called, in order

The registrar's answers need no geometry: each scan with a sample shrinks the prior's standard deviations to a third,
so that a session with the default tolerance converges after its third scan.
"""

from __future__ import annotations

import contextlib
import json
import threading
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from concurrent import futures
from dataclasses import dataclass
from typing import Any

import grpc
import numpy as np
from grpc_health.v1 import health, health_pb2, health_pb2_grpc

from helpers.unimplemented import unimplemented
from pretouch.errors import (
    PROBLEM_METADATA_KEY,
    InvalidInput,
    NotFound,
    PretouchError,
    Unavailable,
    UnknownScene,
    problem,
    wire_of,
)
from pretouch.estimate import Estimate, from_prior, point_error
from pretouch.geometry import Array, Pose
from pretouch.prior import AnyPrior, Prior
from pretouch.rectangle import RotatedRectangle
from pretouch.scene import Scene
from pretouch.tof import RangeSamples
from pretouch.v1 import detector_pb2, detector_pb2_grpc, registrar_pb2, registrar_pb2_grpc
from pretouch.v1 import sensor_gateway_pb2 as gateway_pb2
from pretouch.v1 import sensor_gateway_pb2_grpc as gateway_pb2_grpc
from pretouch.wire import common as wire

PROPOSERS = ("deep", "stability", "narf", "random")
SHRINK = 3.0
DEVICE = "finger"
NOW = 1.7e9
FINGER = gateway_pb2.Device(name=DEVICE, port="/dev/ttyACM0", state=gateway_pb2.DEVICE_STATE_STREAMING, frames=7)
OPTIONS = [("grpc.max_receive_message_length", 64 << 20), ("grpc.max_send_message_length", 64 << 20)]


@dataclass(frozen=True)
class Call:
    """One call that reached a fake: the method's name and the metadata that came with it."""

    method: str
    metadata: dict[str, Any]
    request: Any


class FakeUpstream:
    """The three fakes behind one port of 127.0.0.1, over TLS with `credentials`; `stop` and `start` keep the port.

    Attributes:
        ready: names of the proposers that can be used.
        calls: every call so far, refused ones too.
        samples: what the gateway answers for any span of its device; empty unless the test sets it.
        changed: see `estimating`.
        poses: times of the tip poses of the last StreamPoints call.
    """

    def __init__(self, credentials: grpc.ServerCredentials | None = None) -> None:
        self._credentials = credentials
        self.ready = {"stability", "narf", "random"}
        self.calls: list[Call] = []
        self.samples = RangeSamples(np.zeros(0), np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0, int), np.zeros(0, int))
        self.changed: Callable[[Estimate], Estimate] = _unchanged
        self.poses: list[float] = []
        self._failures: defaultdict[str, list[PretouchError]] = defaultdict(list)
        self._gates: dict[str, threading.Event] = {}
        self._arrived: defaultdict[str, threading.Semaphore] = defaultdict(lambda: threading.Semaphore(0))
        self._port = 0
        self._server: grpc.Server | None = None

    def __enter__(self) -> FakeUpstream:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self._port}"

    def start(self) -> None:
        server = grpc.server(futures.ThreadPoolExecutor(16), options=[*OPTIONS, ("grpc.so_reuseport", 0)])
        detector_pb2_grpc.add_DetectorServiceServicer_to_server(_Detector(self), server)
        registrar_pb2_grpc.add_RegistrarServiceServicer_to_server(_Registrar(self), server)
        gateway_pb2_grpc.add_SensorGatewayServiceServicer_to_server(_Gateway(self), server)
        healthy = health.HealthServicer()
        healthy.set("", health_pb2.HealthCheckResponse.SERVING)
        health_pb2_grpc.add_HealthServicer_to_server(healthy, server)
        if self._credentials is None:
            self._port = server.add_insecure_port(self.address)
        else:
            self._port = server.add_secure_port(self.address, self._credentials)
        server.start()
        self._server = server

    def stop(self) -> None:
        for gate in self._gates.values():
            gate.set()
        if self._server is not None:
            self._server.stop(grace=None).wait()
            self._server = None

    def fail(self, method: str, error: PretouchError, times: int = 1) -> None:
        """The next `times` calls of `method` answer `error`."""
        self._failures[method] += [error] * times

    @contextlib.contextmanager
    def held(self, method: str) -> Iterator[None]:
        """Calls of `method` wait until the block ends."""
        self._arrived[method] = threading.Semaphore(0)
        self._gates[method] = gate = threading.Event()
        try:
            yield
        finally:
            gate.set()
            del self._gates[method]

    @contextlib.contextmanager
    def estimating(self, changed: Callable[[Estimate], Estimate]) -> Iterator[None]:
        """Estimates from scans are changed by the function `changed` until the block ends."""
        self.changed = changed
        try:
            yield
        finally:
            self.changed = _unchanged

    def wait_for_call(self, method: str, seconds: float = 30.0) -> None:
        """Returns once a call of `method` has arrived since the block of `held` began, or what `note` was told of."""
        if not self._arrived[method].acquire(timeout=seconds):
            raise TimeoutError(f"No {method} within {seconds:g} s.")

    def note(self, what: str, times: int = 1) -> None:
        """Lets `wait_for_call` of that name return so many times."""
        self._arrived[what].release(times)

    def count(self, method: str) -> int:
        return Counter(call.method for call in self.calls)[method]

    def enter(self, method: str, request: Any, context: grpc.ServicerContext) -> None:
        """Every fake method starts with this: it records the call, then holds or refuses it if the test said so."""
        self.calls.append(Call(method, dict(context.invocation_metadata()), request))
        self._arrived[method].release()
        if gate := self._gates.get(method):
            gate.wait(60)
        if self._failures[method]:
            refuse(context, self._failures[method].pop(0))


def _unchanged(estimate: Estimate) -> Estimate:
    return estimate


def refuse(context: grpc.ServicerContext, error: PretouchError) -> None:
    """Ends the call as a real service would."""
    context.set_trailing_metadata(((PROBLEM_METADATA_KEY, json.dumps(problem(error)).encode()),))
    context.abort(wire_of(error).grpc_code, error.detail)


def regions(scene: Scene) -> list[RotatedRectangle]:
    """Three rectangles around the object: its bounding box, and its left and right half."""
    u0, v0, u1, v1 = scene.bounds()
    u, v, w, h = (u0 + u1 - 1) / 2, (v0 + v1 - 1) / 2, u1 - u0, v1 - v0
    return [
        RotatedRectangle(u, v, 0.8 * w, 0.8 * h, 0.0),
        RotatedRectangle(u - w / 4, v, 0.5 * w, 0.8 * h, 0.1),
        RotatedRectangle(u + w / 4, v, 0.5 * w, 0.8 * h, -0.1),
    ]


def estimate(scene: Scene, scans: int, samples: int, prior: AnyPrior, at: Array | None = None) -> Estimate:
    """The answer after `scans` scans: towards a shift of (10, -5, 4) mm; each scan multiplies deviations by SHRINK."""
    if scans == 0:
        return from_prior(prior, scene.cloud, at)
    share = 1 - SHRINK**-scans
    covariance = prior.covariance * SHRINK ** (-2 * scans)
    expected, quantile = point_error(covariance, scene.cloud if at is None else at, scene.centroid)
    correction = Pose.of(np.eye(3), share * np.array([0.010, -0.005, 0.004]))
    return Estimate(
        correction,
        scene.centroid,
        covariance,
        expected,
        float(quantile[0]),
        inliers=samples,
        samples=samples,
        rmse=0.0015,
    )


class _Detector(detector_pb2_grpc.DetectorServiceServicer):
    def __init__(self, upstream: FakeUpstream) -> None:
        self.upstream = upstream

    def Propose(self, request: Any, context: grpc.ServicerContext) -> detector_pb2.ProposeResponse:
        self.upstream.enter("Propose", request, context)
        ready = [name for name in PROPOSERS if name in self.upstream.ready]
        chosen = request.proposer or (ready[0] if ready else "")
        if chosen not in ready:
            refuse(context, Unavailable(f"The proposer {chosen!r} is not ready.", "Choose another one."))
        proposed = [
            detector_pb2.ProposedRegion(rectangle=wire.rectangle_to_proto(rectangle), confidence=0.9 - 0.2 * k)
            for k, rectangle in enumerate(regions(wire.scene_from_proto(request.scene)))
        ]
        return detector_pb2.ProposeResponse(regions=proposed, proposer=chosen)

    def ListProposers(self, request: Any, context: grpc.ServicerContext) -> detector_pb2.ListProposersResponse:
        self.upstream.enter("ListProposers", request, context)
        ready = self.upstream.ready
        infos = [
            detector_pb2.ProposerInfo(name=name, ready=name in ready, reason="" if name in ready else "no weights")
            for name in PROPOSERS
        ]
        return detector_pb2.ListProposersResponse(proposers=infos)


class _Registrar(registrar_pb2_grpc.RegistrarServiceServicer):
    RegisterStream = unimplemented

    def __init__(self, upstream: FakeUpstream) -> None:
        self.upstream = upstream
        self.scenes: dict[bytes, Scene] = {}

    def _find_scene(self, request: Any, context: grpc.ServicerContext) -> Scene:
        if request.WhichOneof("target") == "scene":
            scene = wire.scene_from_proto(request.scene)
            self.scenes[scene.digest] = scene
            return scene
        if request.scene_digest not in self.scenes:
            refuse(context, UnknownScene("The scene is not known.", "Send it."))
        return self.scenes[request.scene_digest]

    def _estimate(self, request: Any, context: grpc.ServicerContext) -> Estimate:
        scene = self._find_scene(request, context)
        scans = [wire.scan_from_proto(scan) for scan in request.scans]
        used = [scan for scan in scans if len(scan)]
        prior = wire.prior_from_proto(request.settings) or Prior()
        at = wire.array_from_proto(request.settings.at, "at") if request.settings.HasField("at") else None
        answer = estimate(scene, len(used), sum(map(len, used)), prior, at)
        return self.upstream.changed(answer) if used else answer

    def Register(self, request: Any, context: grpc.ServicerContext) -> registrar_pb2.RegisterResponse:
        self.upstream.enter("Register", request, context)
        return registrar_pb2.RegisterResponse(estimate=wire.estimate_to_proto(self._estimate(request, context)))

    def PredictScans(self, request: Any, context: grpc.ServicerContext) -> registrar_pb2.PredictScansResponse:
        self.upstream.enter("PredictScans", request, context)
        present = self._estimate(request, context).expected_error
        pieces = range(sum(max(1, len(candidate.spans)) for candidate in request.candidates))
        return registrar_pb2.PredictScansResponse(
            expected_errors=[present * min(0.99, 0.5 + 0.05 * k) for k in pieces], expected_returns=[1.0] * len(pieces)
        )


class _Gateway(gateway_pb2_grpc.SensorGatewayServiceServicer):
    Configure = unimplemented

    def __init__(self, upstream: FakeUpstream) -> None:
        self.upstream = upstream

    def _enter(self, method: str, request: Any, context: grpc.ServicerContext) -> None:
        self.upstream.enter(method, request, context)
        if request.device not in ("", DEVICE):
            refuse(context, NotFound(f"There is no device {request.device!r}.", f"The only device is {DEVICE!r}."))

    def ListDevices(self, request: Any, context: grpc.ServicerContext) -> gateway_pb2.ListDevicesResponse:
        self.upstream.enter("ListDevices", request, context)
        return gateway_pb2.ListDevicesResponse(devices=[FINGER])

    def GetStatus(self, request: Any, context: grpc.ServicerContext) -> gateway_pb2.GetStatusResponse:
        self._enter("GetStatus", request, context)
        modules = [gateway_pb2.ModuleStatus(range=np.nan, status=7, range_status=gateway_pb2.RANGE_STATUS_NO_TARGET)]
        return gateway_pb2.GetStatusResponse(device=FINGER, format="binary", rate=30.0, now=NOW, modules=modules)

    def StreamRanges(self, request: Any, context: grpc.ServicerContext) -> Iterator[gateway_pb2.StreamRangesResponse]:
        """Three batches of two measurements, of which the second has no range."""
        self._enter("StreamRanges", request, context)
        for k in range(3):
            batch = gateway_pb2.RangeBatch(
                t=wire.array_to_proto(np.array([NOW + k, NOW + k + 0.5]), "f8"),
                time_std=0.001,
                sequence=wire.array_to_proto(np.array([2 * k, 2 * k + 1]), "u4"),
                range=wire.array_to_proto(np.array([[0.03], [np.nan]]), "f8"),
                raw=wire.array_to_proto(np.array([[0.03], [np.nan]]), "f8"),
                range_status=wire.array_to_proto(np.array([[1], [2]]), "u1"),
                status=wire.array_to_proto(np.array([[0], [7]]), "u1"),
                flags=wire.array_to_proto(np.array([[1], [0]]), "u1"),
            )
            yield gateway_pb2.StreamRangesResponse(batch=batch)

    def StreamPoints(
        self, requests: Iterator[Any], context: grpc.ServicerContext
    ) -> Iterator[gateway_pb2.StreamPointsResponse]:
        """One sample for each pose, after the last; a pose at time 0 is refused."""
        first = next(requests)
        self._enter("StreamPoints", first, context)
        self.upstream.poses = times = []
        for request in requests:
            times += [tip.t for tip in request.tip_poses]
            if 0 in times:
                refuse(context, InvalidInput("A tip pose is of 0.000 s.", "Send Unix time."))
            self.upstream.note("TipPose", len(request.tip_poses))
        samples = gateway_pb2.StreamPointsResponse().samples
        samples.t.shape.append(len(times))
        yield gateway_pb2.StreamPointsResponse(samples=samples, out_of_order=1, unposed=2)

    def GetSamples(self, request: Any, context: grpc.ServicerContext) -> gateway_pb2.GetSamplesResponse:
        self._enter("GetSamples", request, context)
        return gateway_pb2.GetSamplesResponse(samples=wire.samples_to_proto(self.upstream.samples))
