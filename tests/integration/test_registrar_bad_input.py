"""Bad input at the registrar's door: a clear refusal or an honest wide answer, as a process and as a library."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any

import grpc
import numpy as np
import pytest
from google.protobuf.message import Message
from helpers.mesh_cases import blind_scans, mesh_target_of
from helpers.processes import Service, free_port
from helpers.scenes import KINECT, Box, World
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_registrar.engines import Engine
from pretouch_registrar.mesh_scene import mesh_scene
from pretouch_registrar.registration import Registrar, Settings
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import TABLE, make_case

from pretouch.channel import open_sync_channel
from pretouch.errors import InvalidInput, Malformed, PretouchError, TooLarge, from_rpc_error
from pretouch.estimate import Estimate
from pretouch.geometry import Array, Pose
from pretouch.mesh_target import MeshTarget
from pretouch.scene import Scene
from pretouch.tof import Scan, Sensor
from pretouch.trajectory import Trajectory
from pretouch.v1 import common_pb2, registrar_pb2
from pretouch.v1.registrar_pb2_grpc import RegistrarServiceStub
from pretouch.wire.common import (
    array_to_proto,
    estimate_from_proto,
    mesh_from_proto,
    mesh_to_proto,
    scan_to_proto,
    scene_to_proto,
)

REGISTRAR = Registrar()

OBJECT = World((Box.standing((0.10, 0.06, 0.05), yaw=0.4),))
SCENE = OBJECT.scene(KINECT, np.random.default_rng(5)).cropped(0.1)[0]
DOWN = np.array([0.0, 0.0, -1.0])
TIMEOUT = 60.0
BEFORE = REGISTRAR.register(SCENE, [], Settings())
TRUTH = Pose.from_rotation_vector((0.01, -0.02, 0.05), (0.01, -0.008, 0.012))


def measured(start: tuple[float, float], end: tuple[float, float], seed: int = 0) -> Scan:
    """A scan along a straight line, the object being where TRUTH puts it."""
    tip = np.tile(np.eye(4), (2, 1, 1))
    tip[:, :3, :3] = np.diag([1.0, -1.0, -1.0])
    tip[:, :2, 3] = start, end
    tip[:, 2, 3] = 0.085
    path = Trajectory(np.array([0.0, np.linalg.norm(np.subtract(end, start)) / 0.05]), tip)
    return OBJECT.moved(TRUTH).scanned(path, Sensor(), np.random.default_rng(seed)).beams(Sensor())


SCANS = [
    measured((-0.08, -0.01), (0.08, 0.01)),
    measured((0.01, -0.08), (-0.01, 0.08), 1),
    measured((-0.07, 0.05), (0.07, -0.04), 2),
    measured((0.035, -0.07), (0.04, 0.07), 3),
]


@pytest.fixture(scope="module")
def stub() -> Iterator[RegistrarServiceStub]:
    service = Service("registrar", free_port(), {})
    service.start()
    try:
        with open_sync_channel(service.address) as channel:
            yield RegistrarServiceStub(channel)  # type: ignore[no-untyped-call]
        assert not [line for line in service.log if line.get("event") == "a call met a defect"]
    finally:
        service.stop()


def request(scene: Scene = SCENE, scans: list[Scan] | None = None) -> registrar_pb2.RegisterRequest:
    return registrar_pb2.RegisterRequest(
        scene=scene_to_proto(scene), scans=[scan_to_proto(scan) for scan in (SCANS[:1] if scans is None else scans)]
    )


def refused(call: Callable[[], Any]) -> PretouchError:
    with pytest.raises(grpc.RpcError) as raised:
        call()
    return from_rpc_error(raised.value)


def changed(path: str, value: Any) -> registrar_pb2.RegisterRequest:
    """A good request but for the member at `path`."""
    message = request()
    part: Any = message
    *owners, last = path.split(".")
    for owner in owners:
        part = part[int(owner)] if owner.isdigit() else getattr(part, owner)
    if isinstance(value, Message):
        getattr(part, last).CopyFrom(value)
    else:
        setattr(part, last, value)
    return message


def rows(n: int, value: float) -> common_pb2.Array:
    return array_to_proto(np.full((n, 3), value), "f8")


N = len(SCANS[0])
PRIORS = [
    (f"settings.prior.{name}", value)
    for name in ("translation_std", "rotation_std")
    for value in (0.0, -0.01, 1e-300, 1e-9, float("nan"), float("inf"), -float("inf"), 1e3)
]


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("scans.0.origins", rows(N, np.nan)),
        ("scans.0.origins", rows(N, np.inf)),
        ("scans.0.origins", rows(N - 1, 0.0)),
        ("scans.0.directions", rows(N, np.nan)),
        ("scans.0.directions", rows(N, 0.0)),
        ("scans.0.ranges", array_to_proto(np.full(N, np.inf), "f8")),
        ("scans.0.ranges", array_to_proto(np.full(N, -0.01), "f8")),
        ("scans.0.ranges", common_pb2.Array()),
        *PRIORS,
        ("settings.sensor.range_std", 0.0),
        ("settings.sensor.range_std", float("nan")),
        ("settings.sensor.beam_half_angle", 2.0),
        ("settings.sensor.range_max", float("inf")),
        ("scene.table.offset", float("nan")),
        ("scene.base_t_camera", common_pb2.Pose(matrix=[float("nan")] * 16)),
        ("scene.depth", array_to_proto(np.full((10, 10), np.nan), "f4")),
        ("scene.depth", array_to_proto(np.full(SCENE.mask.shape, np.nan), "f4")),
        ("scene.mask", array_to_proto(np.zeros(SCENE.mask.shape), "u1")),
        ("scene", common_pb2.Scene()),
        ("mesh", common_pb2.MeshTarget()),
    ],
)
def test_a_bad_number_is_refused_with_what_to_do(stub: RegistrarServiceStub, path: str, value: Any) -> None:
    error = refused(lambda: stub.Register(changed(path, value), timeout=TIMEOUT))
    assert isinstance(error, InvalidInput)
    assert error.detail
    assert error.remedy


def test_ten_million_pixels_are_too_many(stub: RegistrarServiceStub) -> None:
    depth, mask = np.ones((2500, 4000)), np.ones((2500, 4000))
    large = changed("scene.depth", array_to_proto(depth, "u2"))
    large.scene.mask.CopyFrom(array_to_proto(mask, "u1"))
    error = refused(lambda: stub.Register(large, timeout=TIMEOUT))
    assert type(error) is TooLarge
    assert "10000000 pixels; the limit is 4000000" in error.detail
    assert "smaller or cropped" in error.remedy
    header = registrar_pb2.RegisterStreamHeader(scene_bytes=50_000_000)
    steps = [registrar_pb2.RegisterStreamRequest(header=header)]
    error = refused(lambda: list(stub.RegisterStream(iter(steps), timeout=TIMEOUT)))
    assert type(error) is TooLarge
    assert "Crop" in error.remedy


def test_an_image_at_the_limit_is_answered(stub: RegistrarServiceStub) -> None:
    depth = np.zeros((2000, 2000), dtype=np.float32)
    h, w = SCENE.mask.shape
    depth[:h, :w] = SCENE.depth.metres
    mask = np.zeros(depth.shape, dtype=bool)
    mask[:h, :w] = SCENE.mask
    large = request()
    large.scene.depth.CopyFrom(array_to_proto(depth, "f4"))
    large.scene.mask.CopyFrom(array_to_proto(mask, "u1"))
    answer = estimate_from_proto(stub.Register(large, timeout=TIMEOUT).estimate)
    assert answer.expected_error < BEFORE.expected_error


MESH = MeshTarget(MAKERS["box"]().vertices, MAKERS["box"]().faces, Pose.identity(), TABLE)
BAD_MESHES: list[tuple[str, Any, type[PretouchError], str]] = [
    ("vertices", array_to_proto(np.zeros((0, 3)), "f4"), InvalidInput, "there are 0"),
    ("vertices", array_to_proto(np.full((8, 3), np.nan), "f4"), Malformed, "NaN"),
    ("vertices", array_to_proto(MESH.vertices[:, :2], "f4"), InvalidInput, "shape"),
    ("vertices", array_to_proto(1000 * MESH.vertices, "f4"), InvalidInput, "140 m long"),
    ("vertices", array_to_proto(0 * MESH.vertices, "f4"), InvalidInput, "no area"),
    ("faces", array_to_proto(np.zeros((0, 3)), "u4"), InvalidInput, "shape [0, 3]"),
    ("faces", array_to_proto(np.full((1, 3), 8), "u4"), InvalidInput, "names vertex 8"),
    ("faces", array_to_proto(np.full((1, 3), 2**32 - 1), "u4"), InvalidInput, "names vertex 4294967295"),
    ("faces", array_to_proto(MESH.faces, "f4"), InvalidInput, "float32"),
    ("faces", array_to_proto(np.zeros((1_000_001, 3)), "u2"), TooLarge, "limit is 1000000 faces"),
    ("base_t_object", common_pb2.Pose(matrix=[0.0] * 16), InvalidInput, "rigid"),
    ("table", common_pb2.Plane(), InvalidInput, "mesh.table.normal has 0 numbers"),
]


@pytest.mark.parametrize("streamed", [False, True])
@pytest.mark.parametrize(("member", "value", "kind", "said"), BAD_MESHES)
def test_a_bad_mesh_is_refused(
    stub: RegistrarServiceStub, streamed: bool, member: str, value: Message, kind: type[PretouchError], said: str
) -> None:
    mesh = mesh_to_proto(MESH)
    getattr(mesh, member).CopyFrom(value)
    if streamed:
        error = refused(lambda: list(stub.RegisterStream(iter(opening(mesh)), timeout=TIMEOUT)))
    else:
        error = refused(lambda: stub.Register(registrar_pb2.RegisterRequest(mesh=mesh), timeout=TIMEOUT))
    assert type(error) is kind
    assert said in error.detail
    assert error.remedy


def opening(target: common_pb2.Scene | common_pb2.MeshTarget) -> list[registrar_pb2.RegisterStreamRequest]:
    """Header and chunks of a stream."""
    data = target.SerializeToString()
    of = "mesh_bytes" if isinstance(target, common_pb2.MeshTarget) else "scene_bytes"
    header = registrar_pb2.RegisterStreamHeader(**{of: len(data)})
    return [
        registrar_pb2.RegisterStreamRequest(header=header),
        *(registrar_pb2.RegisterStreamRequest(scene_chunk=data[k : k + 2**20]) for k in range(0, len(data), 2**20)),
    ]


def equal(one: Estimate, other: Estimate) -> bool:
    return (
        np.array_equal(one.base_T_correction.matrix, other.base_T_correction.matrix)
        and np.array_equal(one.covariance, other.covariance)
        and (one.expected_error, one.error_quantile, one.inliers, one.samples, one.rmse)
        == (other.expected_error, other.error_quantile, other.inliers, other.samples, other.rmse)
        and [weak.text for weak in one.unobservable] == [weak.text for weak in other.unobservable]
    )


def both(stub: RegistrarServiceStub, scans: list[Scan]) -> Estimate:
    """The answer, which the process and the library agree on to the bit."""
    here = REGISTRAR.register(SCENE, scans, Settings())
    there = estimate_from_proto(stub.Register(request(scans=scans), timeout=TIMEOUT).estimate)
    assert equal(here, there)
    return here


def moved(estimate: Estimate) -> float:
    """m: how far the object's middle was moved."""
    return float(np.linalg.norm(estimate.base_T_correction.apply(estimate.centroid) - estimate.centroid))


TOP = SCENE.cloud[SCENE.cloud[:, 2] > 0.045]
OFFSETS = [
    np.array(offset)
    for offset in itertools.product((-0.3, 0.0, 0.3), (-0.3, 0.0, 0.3), (-0.3, -0.03, 0.0, 0.3))
    if np.linalg.norm(offset[:2]) > 0.2 or abs(offset[2]) > 0.2
]


@pytest.mark.parametrize("offset", OFFSETS, ids=str)
def test_scans_thirty_centimetres_away_leave_the_prior(stub: RegistrarServiceStub, offset: Array) -> None:
    rng = np.random.default_rng(0)
    scans = [Scan.of_points(SCENE.cloud[rng.choice(len(SCENE.cloud), 100)] + offset, DOWN) for _ in range(4)]
    answer = both(stub, scans)
    assert answer.expected_error > 0.9 * BEFORE.expected_error
    assert answer.error_quantile > 0.9 * BEFORE.error_quantile
    assert moved(answer) < 0.5 * BEFORE.expected_error


@pytest.mark.parametrize("engine", list(Engine))
@pytest.mark.parametrize("offset", [(0.15, 0.0, 0.0), (0.0, -0.15, 0.0), (0.0, 0.0, 0.1), (0.0, 0.0, 0.15)], ids=str)
def test_a_match_that_contradicts_the_prior_is_no_certain_one(engine: Engine, offset: tuple[float, ...]) -> None:
    rng = np.random.default_rng(0)
    scans = [Scan.of_points(SCENE.cloud[rng.choice(len(SCENE.cloud), 100)] + offset, DOWN) for _ in range(4)]
    answer = REGISTRAR.register(SCENE, scans, Settings(engine=engine))
    assert answer.expected_error > 0.65 * BEFORE.expected_error
    assert answer.error_quantile > 0.5 * moved(answer)


def misses(height: float) -> Scan:
    origins = SCENE.centroid + np.linspace(-0.1, 0.1, 60)[:, None] * (1, 0, 0) + (0, 0, height)
    return Scan(origins, np.tile(DOWN, (60, 1)), np.full(60, np.nan))


SLIGHT: dict[str, list[Scan]] = {
    "no scan": [],
    "an empty scan": [Scan.of_points(np.zeros((0, 3)), DOWN)],
    "many empty scans": [Scan.of_points(np.zeros((0, 3)), DOWN)] * 50,
    "misses far above": [misses(0.3)],
    "one point": [Scan.of_points(TOP[:1], DOWN)],
    "two points": [Scan.of_points(TOP[::300][:2], DOWN)],
    "five points, fewer than unknowns": [Scan.of_points(TOP[::200][:5], DOWN)],
    "one point 300 times": [Scan.of_points(np.repeat(TOP[:1], 300, axis=0), DOWN)],
    "one point 300 times in each of 20 scans": [Scan.of_points(np.repeat(TOP[:1], 300, axis=0), DOWN)] * 20,
    "a line of 2 cm": [Scan.of_points(TOP.mean(axis=0) + np.linspace(-0.01, 0.01, 60)[:, None] * (1, 0, 0), DOWN)],
}  # fmt: skip


@pytest.mark.parametrize("case", SLIGHT)
def test_few_samples_leave_a_wide_covariance(stub: RegistrarServiceStub, case: str) -> None:
    answer = both(stub, SLIGHT[case])
    sideways = np.sqrt(np.linalg.eigvalsh(answer.covariance[3:5, 3:5]))
    assert sideways.min() > 0.005
    assert answer.error_quantile > 0.5 * BEFORE.error_quantile
    assert moved(answer) < answer.error_quantile
    assert np.linalg.eigvalsh(answer.covariance).min() > 0


def test_misses_over_the_object_make_nothing_certain(stub: RegistrarServiceStub) -> None:
    answer = both(stub, [misses(0.05)])
    assert answer.inliers == 0
    assert answer.error_quantile > 0.6 * BEFORE.error_quantile


@pytest.mark.parametrize(("translation", "rotation"), [(1e-6, 1e-6), (1e-6, 1.0), (1.0, 1e-6), (1.0, 1.0)])
def test_the_surest_and_the_widest_prior_are_answered(
    stub: RegistrarServiceStub, translation: float, rotation: float
) -> None:
    message = request(scans=SCANS)
    message.settings.prior.translation_std, message.settings.prior.rotation_std = translation, rotation
    answer = estimate_from_proto(stub.Register(message, timeout=TIMEOUT).estimate)
    assert np.isfinite(answer.covariance).all()
    assert np.linalg.eigvalsh(answer.covariance).min() > 0
    std = np.sqrt(np.diag(answer.covariance))
    assert std[:3].max() <= 2 * rotation
    assert std[3:].max() <= 2 * translation


def test_the_same_scan_again_tells_nothing_new(stub: RegistrarServiceStub) -> None:
    assert equal(both(stub, SCANS[:2]), both(stub, [*SCANS[:2], SCANS[0], SCANS[1], SCANS[0]]))


def test_beams_that_differ_only_in_direction_are_not_taken_for_each_other() -> None:
    down = Scan(SCANS[0].origins, np.tile(DOWN, (N, 1)), SCANS[0].ranges)
    slanted = Scan(down.origins, np.tile([0.3, 0.0, -np.sqrt(0.91)], (N, 1)), down.ranges)
    answers = [REGISTRAR.register(SCENE, [scan], Settings()) for scan in (down, slanted)]
    assert not answers[0].base_T_correction.is_close(answers[1].base_T_correction, 1e-6)


@pytest.fixture(scope="module")
def single(stub: RegistrarServiceStub) -> dict[tuple[int, ...], Estimate]:
    """By which of SCANS were given: what `Register` answers."""
    subsets = [s for n in range(1, len(SCANS) + 1) for s in itertools.combinations(range(len(SCANS)), n)]
    return {
        subset: estimate_from_proto(stub.Register(request(scans=[SCANS[k] for k in subset]), timeout=TIMEOUT).estimate)
        for subset in subsets
    }


@settings(max_examples=24, deadline=None)
@given(order=st.permutations(range(len(SCANS))))
def test_streams_in_any_order_answer_as_single_calls_do(
    stub: RegistrarServiceStub, single: dict[tuple[int, ...], Estimate], order: list[int]
) -> None:
    steps = opening(scene_to_proto(SCENE))
    steps += [registrar_pb2.RegisterStreamRequest(scan=scan_to_proto(SCANS[k])) for k in order]
    answers = [estimate_from_proto(answer.estimate) for answer in stub.RegisterStream(iter(steps), timeout=TIMEOUT)]
    assert len(answers) == len(order)
    for k, answer in enumerate(answers, start=1):
        assert equal(answer, single[tuple(sorted(order[:k]))])


def test_a_mesh_is_matched_over_the_wire_as_in_process(stub: RegistrarServiceStub) -> None:
    case = make_case("box", MAKERS["box"](), 0)
    target = mesh_target_of(case)
    scans = blind_scans(case)
    sent = [scan_to_proto(scan) for scan in scans]
    message = mesh_to_proto(target)
    answer = estimate_from_proto(
        stub.Register(registrar_pb2.RegisterRequest(mesh=message, scans=sent), timeout=TIMEOUT).estimate
    )
    steps = opening(message) + [registrar_pb2.RegisterStreamRequest(scan=scan) for scan in sent]
    *_, last = stub.RegisterStream(iter(steps), timeout=TIMEOUT)
    assert equal(answer, estimate_from_proto(last.estimate))
    view = Scene(case.depth, case.camera, case.base_T_camera, case.mask, target.table).cropped(0.1)[0]
    by_camera = REGISTRAR.register(view, scans, Settings())
    assert case.error(answer.base_T_correction) <= case.error(by_camera.base_T_correction)
    assert equal(answer, REGISTRAR.register(mesh_scene(mesh_from_proto(message)), scans, Settings()))
    path = registrar_pb2.CandidatePath(
        t=array_to_proto(np.array([0.0, 2.0]), "f8"),
        base_t_tip=array_to_proto(
            np.stack([Pose.of(np.diag([1.0, -1.0, -1.0]), [0.5, y, 0.17]).matrix for y in (-0.05, 0.05)]), "f8"
        ),
    )
    predicted = stub.PredictScans(
        registrar_pb2.PredictScansRequest(mesh=message, scans=sent, candidates=[path]), timeout=TIMEOUT
    )
    assert 0 < predicted.expected_errors[0] < 1.1 * answer.expected_error
