"""Registrar and detector over real gRPC: the same answers as in process, and clear refusals."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.message import Message
from grpc.aio import AioRpcError
from helpers import made_network
from helpers.scenes import Box, World
from pretouch_detector.model.weights import Weights
from pretouch_detector.proposals import deep
from pretouch_detector.service import running as detector_running
from pretouch_registrar.registration import Registrar
from pretouch_registrar.registration import Settings as RegistrationSettings
from pretouch_registrar.service import running as registrar_running

from pretouch.channel import open_channel
from pretouch.errors import InvalidInput, Malformed, PretouchError, TooLarge, Unavailable, from_rpc_error
from pretouch.geometry import Pose
from pretouch.scan_prediction import Candidate
from pretouch.serving import Running, Settings, started
from pretouch.tof import Scan, Sensor
from pretouch.trajectory import Trajectory
from pretouch.v1 import detector_pb2, registrar_pb2
from pretouch.v1.detector_pb2_grpc import DetectorServiceStub
from pretouch.v1.registrar_pb2_grpc import RegistrarServiceStub
from pretouch.wire.common import array_to_proto, estimate_from_proto, scan_to_proto, scene_to_proto
from pretouch.wire.scan_prediction import candidate_to_proto, predictions_from_proto

WORLD = World((Box.standing((0.08, 0.06, 0.05), yaw=0.3),))
SCENE = WORLD.scene().cropped(0.08)[0]
MIB = 2**20


def path(y: float) -> Trajectory:
    tip = np.tile(np.eye(4), (2, 1, 1))
    tip[:, :3, :3] = np.diag([1.0, -1.0, -1.0])
    tip[:, :3, 3] = [(-0.07, y, 0.08), (0.07, y, 0.08)]
    return Trajectory(np.array([0.0, 2.8]), tip)


def scans() -> list[Scan]:
    truth = WORLD.moved(Pose.from_rotation_vector((0, 0, 0.05), (0.01, -0.01, 0.008)))
    return [truth.scanned(path(y), Sensor()).beams(Sensor()) for y in (-0.01, 0.0, 0.02)]


@asynccontextmanager
async def served(name: str, running: Running, stub: Any) -> AsyncIterator[Any]:
    async with (
        started(name, running, Settings(grace=1.0)) as service,
        open_channel(f"127.0.0.1:{service.port}") as channel,
    ):
        yield stub(channel)


def stream(*steps: dict[str, Any]) -> list[registrar_pb2.RegisterStreamRequest]:
    return [registrar_pb2.RegisterStreamRequest(**step) for step in steps]


def scene_steps(chunk: int = MIB) -> list[registrar_pb2.RegisterStreamRequest]:
    data = scene_to_proto(SCENE).SerializeToString()
    header = registrar_pb2.RegisterStreamHeader(scene_bytes=len(data))
    return stream({"header": header}, *({"scene_chunk": data[k : k + chunk]} for k in range(0, len(data), chunk)))


async def refusal(call: Any) -> PretouchError:
    async def answered() -> None:
        if hasattr(call, "__aiter__"):
            async for _ in call:
                pass
        else:
            await call

    with pytest.raises(AioRpcError) as raised:
        await answered()
    return from_rpc_error(raised.value)


async def test_a_stream_gives_the_same_answers_as_single_calls_and_as_the_library() -> None:
    async with served("registrar", registrar_running, RegistrarServiceStub) as stub:
        steps = scene_steps(chunk=50_000) + stream(*({"scan": scan_to_proto(scan)} for scan in scans()))
        streamed = [
            estimate_from_proto(answer.estimate) async for answer in stub.RegisterStream(iter(steps), timeout=60)
        ]
        assert len(streamed) == 3
        for k, answer in enumerate(streamed, start=1):
            request = registrar_pb2.RegisterRequest(
                scene=scene_to_proto(SCENE), scans=[scan_to_proto(s) for s in scans()[:k]]
            )
            single = estimate_from_proto((await stub.Register(request, timeout=60)).estimate)
            library = Registrar().register(SCENE, scans()[:k], RegistrationSettings())
            for other in (single, library):
                assert answer.base_T_correction.is_close(other.base_T_correction, 1e-12)
                np.testing.assert_array_equal(answer.covariance, other.covariance)
        assert streamed[2].expected_error < streamed[0].expected_error


async def test_predictions_come_one_a_candidate() -> None:
    async with served("registrar", registrar_running, RegistrarServiceStub) as stub:
        candidates = [
            registrar_pb2.CandidatePath(t=array_to_proto(p.t, "f8"), base_t_tip=array_to_proto(p.base_T_tip, "f8"))
            for p in (path(0.0), path(0.3))
        ]
        request = registrar_pb2.PredictScansRequest(scene=scene_to_proto(SCENE), candidates=candidates)
        answer = await stub.PredictScans(request, timeout=60)
        across, elsewhere = answer.expected_errors
        assert across < elsewhere
        assert len(answer.expected_returns) == 2


async def test_predictions_come_one_a_span_in_order() -> None:
    async with served("registrar", registrar_running, RegistrarServiceStub) as stub:
        whole, other = path(0.0), path(0.3)
        end = float(whole.t[-1])
        candidates = [Candidate(other, ((0.0, end),)), Candidate(whole, ((0.0, end / 2), (0.0, end))), Candidate(other)]
        request = registrar_pb2.PredictScansRequest(
            scene=scene_to_proto(SCENE), candidates=map(candidate_to_proto, candidates)
        )
        message = await stub.PredictScans(request, timeout=60)
        (first,), (half, all_), (last,) = predictions_from_proto(message, candidates)
        assert first == last
        assert all_.expected_error < half.expected_error < first.expected_error


@pytest.mark.parametrize(
    ("spans", "said"),
    [
        ([(0.0, 1e3)], "A span is from 0 to 1000 s"),
        ([(0.5, 0.5)], "A span is from 0.5 to 0.5 s"),
        ([(float("nan"), 0.5)], "A span is from nan"),
        ([(0.0, 0.5)] * 2001, "The candidates have 2001 pieces"),
    ],
)
async def test_spans_that_cannot_be_predicted_are_refused(spans: list[tuple[float, float]], said: str) -> None:
    async with served("registrar", registrar_running, RegistrarServiceStub) as stub:
        message = candidate_to_proto(Candidate(path(0.0)))
        message.spans.extend(registrar_pb2.Span(start=start, end=end) for start, end in spans)
        request = registrar_pb2.PredictScansRequest(scene=scene_to_proto(SCENE), candidates=[message])
        with pytest.raises(AioRpcError) as failure:
            await stub.PredictScans(request, timeout=60)
        error = from_rpc_error(failure.value)
        assert isinstance(error, InvalidInput)
        assert error.detail.startswith(said)


def _broken(**change: Any) -> registrar_pb2.RegisterRequest:
    request = registrar_pb2.RegisterRequest(scene=scene_to_proto(SCENE), scans=[scan_to_proto(scans()[0])])
    for name, value in change.items():
        part: Message = request
        *owners, last = name.split("__")
        for owner in owners:
            part = getattr(part, owner)
        if isinstance(value, Message):
            getattr(part, last).CopyFrom(value)
        else:
            setattr(part, last, value)
    return request


@pytest.mark.parametrize(
    "request_",
    [
        _broken(settings__engine="magic"),
        _broken(settings__prior__translation_std=-1.0),
        _broken(scene__camera__fx=float("nan")),
        _broken(scene__mask=array_to_proto(np.zeros((3, 3)), "u1")),
        _broken(scene__depth__data=b"123"),
        registrar_pb2.RegisterRequest(),
    ],
    ids=["engine", "prior", "camera", "mask", "depth", "empty"],
)
async def test_a_bad_request_is_refused_with_what_to_do(request_: registrar_pb2.RegisterRequest) -> None:
    async with served("registrar", registrar_running, RegistrarServiceStub) as stub:
        error = await refusal(stub.Register(request_, timeout=60))
        assert isinstance(error, InvalidInput)
        assert error.detail
        assert error.remedy


async def test_a_stream_out_of_order_is_refused() -> None:
    header = registrar_pb2.RegisterStreamHeader
    scan = {"scan": scan_to_proto(scans()[0])}
    cases: list[tuple[list[registrar_pb2.RegisterStreamRequest], type[PretouchError]]] = [
        ([], InvalidInput),
        (stream(scan), InvalidInput),
        (stream({"header": header(scene_bytes=2**40)}), TooLarge),
        (stream({"header": header(scene_bytes=4)}, {"scene_chunk": b"\xff\xff\xff\xff"}), Malformed),
        (stream({"header": header(scene_bytes=4)}, {"scene_chunk": b"12345"}), InvalidInput),
        (scene_steps()[:-1], InvalidInput),
        (scene_steps() + stream({"scene_chunk": b"1"}), InvalidInput),
    ]
    async with served("registrar", registrar_running, RegistrarServiceStub) as stub:
        for steps, kind in cases:
            assert type(await refusal(stub.RegisterStream(iter(steps), timeout=60))) is kind


@pytest.mark.parametrize("weights", ["good", "missing"])
async def test_the_detector_proposes_and_names_what_is_ready(
    weights: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = made_network.write(tmp_path / "weights") if weights == "good" else tmp_path
    monkeypatch.setattr(deep, "WEIGHTS", Weights(folder))
    best = ["deep"] if weights == "good" else []
    async with served("detector", detector_running, DetectorServiceStub) as stub:
        listed = (await stub.ListProposers(detector_pb2.ListProposersRequest(), timeout=60)).proposers
        ready = [info.name for info in listed if info.ready]
        assert ready == [*best, "stability", "random", "narf"]
        assert all(info.reason for info in listed if not info.ready)
        scene = scene_to_proto(SCENE)
        answer = await stub.Propose(detector_pb2.ProposeRequest(scene=scene, count=7, seed=3), timeout=60)
        assert answer.proposer == ready[0]
        assert len(answer.regions) == 7
        again = detector_pb2.ProposeRequest(scene=scene, proposer=ready[0], count=7, seed=3)
        assert await stub.Propose(again, timeout=60) == answer
        same = await stub.Propose(detector_pb2.ProposeRequest(scene=scene, proposer="narf", seed=1), timeout=60)
        assert same.proposer == "narf"
        assert 1 <= len(same.regions) <= 20
        assert same == await stub.Propose(detector_pb2.ProposeRequest(scene=scene, proposer="narf", seed=2), timeout=60)
        if not best:
            refused = await refusal(stub.Propose(detector_pb2.ProposeRequest(scene=scene, proposer="deep"), timeout=60))
            assert isinstance(refused, Unavailable)
            assert refused.remedy == "Choose one of stability, random, narf."
        unknown = detector_pb2.ProposeRequest(scene=scene, proposer="oracle")
        assert isinstance(await refusal(stub.Propose(unknown, timeout=60)), InvalidInput)
