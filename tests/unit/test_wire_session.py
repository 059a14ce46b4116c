"""Requests, sessions and scans round-trip through JSON and protobuf."""

import dataclasses
import json
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.priors import pose_priors
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pretouch.camera import Camera
from pretouch.errors import InvalidInput, Malformed, TooLarge
from pretouch.estimate import Estimate, Mode, WeakDirection, from_prior
from pretouch.geometry import Plane, Pose
from pretouch.prior import Prior
from pretouch.rectangle import RotatedRectangle
from pretouch.session import (
    Budget,
    BudgetUsed,
    Forecast,
    GatewaySpan,
    Planner,
    Points,
    Proposer,
    Region,
    SampleChunk,
    ScanPlan,
    ScanProgress,
    ScanSettings,
    ScanSummary,
    Session,
    SessionRequest,
    Skipped,
    State,
    Submission,
    Telling,
    Tolerance,
)
from pretouch.tof import MAX_SAMPLES, RangeSamples, Sensor
from pretouch.trajectory import Trajectory
from pretouch.v1 import common_pb2
from pretouch.v1 import orchestrator_pb2 as pb
from pretouch.wire import session as proto
from pretouch.wire.common import estimate_from_proto, estimate_to_proto
from pretouch.wire.json import (
    estimate_from_json,
    estimate_to_json,
    progress_from_json,
    progress_to_json,
    request_from_json,
    request_to_json,
    session_from_json,
    session_to_json,
    submission_from_json,
    submission_to_json,
    telling_from_json,
    telling_to_json,
)
from pretouch.wire.reader import Members

numbers = st.floats(-10, 10, allow_subnormal=False)
shares = st.floats(1e-6, 1)
vectors = arrays(np.float64, 3, elements=numbers)
poses = st.builds(Pose.from_rotation_vector, vectors, vectors)
names = st.text(min_size=1, max_size=12)
planes = st.builds(
    lambda normal, offset: Plane(normal / np.linalg.norm(normal), offset),
    vectors.filter(lambda v: np.linalg.norm(v) > 0.1),
    numbers,
)
requests = st.builds(
    SessionRequest,
    camera=st.builds(Camera, st.floats(1, 5000), st.floats(1, 5000), numbers, numbers),
    base_T_camera=poses,
    depth_scale=shares,
    roi=st.none() | st.tuples(*[st.integers(0, 100)] * 2, *[st.integers(101, 5000)] * 2),
    table=st.none() | planes,
    base_T_object=st.none() | poses,
    prior=st.none() | st.builds(Prior, shares, shares) | pose_priors,
    tolerance=st.builds(
        Tolerance,
        shares,
        st.floats(0.01, 0.9999),
        st.none() | arrays(np.float64, st.tuples(st.integers(1, 64), st.just(3)), elements=numbers),
    ),
    budget=st.builds(Budget, st.integers(1, 1000), st.floats(0.1, 1e6), shares),
    sensor=st.builds(
        Sensor,
        range_min=st.floats(0, 0.01),
        range_max=st.floats(0.1, 10),
        range_std=st.floats(1e-6, 0.1),
        beam_half_angle=st.floats(0, 0.7),
        rate=st.floats(0.1, 10_000),
        tip_T_module=st.lists(poses, min_size=1, max_size=3).map(tuple),
        range_bias_std=st.floats(0, 0.1),
    ),
    scan=st.builds(ScanSettings, st.floats(0.02, 0.09), st.floats(0.001, 10), st.booleans()),
    proposer=st.none() | st.sampled_from(Proposer),
    planner=st.sampled_from(Planner),
)


@st.composite
def tip_poses(draw: st.DrawFn, count: int) -> np.ndarray:
    return np.stack([pose.matrix for pose in draw(st.lists(poses, min_size=count, max_size=count))])


@st.composite
def range_samples(draw: st.DrawFn) -> RangeSamples:
    count = draw(st.integers(1, 4))
    codes = arrays(np.int64, count, elements=st.integers(0, 255))
    return RangeSamples(
        t=np.sort(draw(arrays(np.float64, count, elements=numbers))),
        base_T_tip=draw(tip_poses(count)),
        range=draw(arrays(np.float64, count, elements=st.just(math.nan) | st.floats(0, 10))),
        status=draw(codes),
        module=draw(codes),
    )


@st.composite
def plans(draw: st.DrawFn) -> ScanPlan:
    count = draw(st.integers(1, 4))
    steps = draw(arrays(np.float64, count, elements=st.floats(0.01, 5)))
    path = Trajectory(np.cumsum(steps) - steps[0], draw(tip_poses(count)))
    return ScanPlan(draw(names), draw(names), draw(st.none() | names), path, draw(st.floats(0, 1)))


counts = st.integers(0, 10_000)


@st.composite
def modes(draw: st.DrawFn) -> tuple[Mode, ...]:
    places = draw(st.lists(st.tuples(poses, st.floats(0.01, 1)), min_size=1, max_size=3))
    total = sum(weight for _, weight in places)
    return tuple(Mode(pose, weight / total) for pose, weight in places)


estimates = st.builds(
    lambda modes, **members: Estimate(modes[0].base_T_correction, modes=modes, **members),
    modes(),
    centroid=vectors,
    covariance=arrays(np.float64, (6, 6), elements=numbers),
    expected_error=shares,
    error_quantile=shares,
    unobservable=st.lists(
        st.builds(WeakDirection, arrays(np.float64, 6, elements=numbers), shares, st.text(max_size=20), st.booleans()),
        max_size=2,
    ).map(tuple),
    inliers=counts,
    samples=counts,
    rmse=shares,
    fit=st.floats(0, 1),
)
rectangles = st.builds(RotatedRectangle, numbers, numbers, st.floats(1, 500), st.floats(1, 500), st.floats(-4, 4))
sessions = st.builds(
    Session,
    id=names,
    state=st.sampled_from(State),
    proposer=st.sampled_from(Proposer),
    planner=st.sampled_from(Planner),
    regions=st.lists(st.builds(Region, names, rectangles, shares, shares), max_size=2).map(tuple),
    estimate=estimates,
    next_scan=st.none() | plans(),
    scans=st.lists(
        st.builds(ScanSummary, names, names, st.none() | names, counts, counts, shares, shares, shares), max_size=2
    ).map(tuple),
    budget_used=st.builds(BudgetUsed, counts, shares, shares),
    base_T_object=st.none() | poses,
    forecast=st.none() | st.builds(Forecast, numbers, numbers, st.floats(0, 1)),
    reason=st.none() | st.just({"type": "urn:pretouch:problem:internal", "status": 500, "detail": "x"}),
)
submissions = st.one_of(
    range_samples(),
    st.builds(Points, arrays(np.float64, st.tuples(st.integers(1, 4), st.just(3)), elements=numbers)),
    st.builds(GatewaySpan, names, st.floats(0, 10), st.floats(11, 20)),
    st.builds(Skipped, st.none() | range_samples()),
)

tellings = st.one_of(
    st.builds(SampleChunk, counts, range_samples() | st.just(RangeSamples.concatenate([]))),
    st.builds(GatewaySpan, names, st.floats(0, 10), st.floats(11, 20)),
)


def same(a: Any, b: Any) -> bool:
    """Equal, arrays to 1e-9: a rotation goes through its quaternion in JSON."""
    if dataclasses.is_dataclass(a):
        return type(a) is type(b) and all(
            same(getattr(a, field.name), getattr(b, field.name)) for field in dataclasses.fields(a)
        )
    if isinstance(a, np.ndarray):
        return a.shape == b.shape and np.allclose(a, b, rtol=0, atol=1e-9, equal_nan=True)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, float):
        return bool(abs(a - b) <= 1e-9)
    return bool(a == b)


def through_json(document: dict[str, Any]) -> Any:
    return json.loads(json.dumps(document, allow_nan=False))


@settings(max_examples=60)
@given(requests)
def test_both_wires_give_a_request_back(request: SessionRequest) -> None:
    depth = np.arange(12, dtype=np.uint16).reshape(3, 4)
    mask = depth > 3
    message = proto.request_to_proto(request, depth, mask, "key")
    packed = pb.CreateSessionRequest.FromString(message.SerializeToString())
    got, values, got_mask = proto.request_from_proto(packed)
    assert same(request, got)
    assert same(request, request_from_json(through_json(request_to_json(request))))
    assert values.dtype == np.uint16
    np.testing.assert_array_equal(values, depth)
    assert got_mask is not None
    np.testing.assert_array_equal(got_mask, mask)
    assert packed.idempotency_key == "key"


@settings(max_examples=60)
@given(sessions)
def test_both_wires_give_a_session_back(session: Session) -> None:
    packed = pb.Session.FromString(proto.session_to_proto(session).SerializeToString())
    assert same(session, proto.session_from_proto(packed))
    assert same(session, session_from_json(through_json(session_to_json(session))))


def test_what_is_wrong_with_the_sensor_goes_over_protobuf_and_is_no_member_of_the_json() -> None:
    estimate = replace(from_prior(Prior(), np.eye(3)), sensor_problem="All 3 ranges are 31 mm.")
    packed = common_pb2.Estimate.FromString(estimate_to_proto(estimate).SerializeToString())
    assert estimate_from_proto(packed).sensor_problem == estimate.sensor_problem
    document = estimate_to_json(estimate, None)
    assert document["modes"] == [{"base_T_correction": document["base_T_correction"], "weight": 1.0}]
    assert document["fit"] == 1.0
    assert "sensor_problem" not in document


def test_an_estimate_without_modes_and_fit_is_one_from_before_they_were_told() -> None:
    message = estimate_to_proto(from_prior(Prior(), np.eye(3)))
    message.ClearField("modes")
    message.ClearField("fit")
    estimate = estimate_from_proto(message)
    assert [mode.weight for mode in estimate.modes] == [1.0]
    assert estimate.fit == 1.0
    message.fit = 0.0
    assert estimate_from_proto(message).fit == 0.0


@pytest.mark.parametrize("fit", [-0.1, 1.1, math.nan])
def test_a_fit_that_is_no_probability_is_refused_on_both_wires(fit: float) -> None:
    message = estimate_to_proto(from_prior(Prior(), np.eye(3)))
    message.fit = fit
    with pytest.raises(InvalidInput, match=r"estimate\.fit"):
        estimate_from_proto(message)
    document = estimate_to_json(from_prior(Prior(), np.eye(3)), None) | {"fit": fit}
    with pytest.raises(InvalidInput, match=r"estimate\.fit"):
        estimate_from_json(Members(document, "estimate", None))


@settings(max_examples=60)
@given(submissions)
def test_both_wires_give_a_submission_back(submission: Submission) -> None:
    packed = pb.SubmitScanRequest.FromString(proto.submission_to_proto("s", "c", submission).SerializeToString())
    assert (packed.session_id, packed.scan_id) == ("s", "c")
    assert same(submission, proto.submission_from_proto(packed))
    assert same(submission, submission_from_json(through_json(submission_to_json(submission))))


@settings(max_examples=60)
@given(tellings)
def test_both_wires_give_samples_of_a_scan_under_way_back(telling: Telling) -> None:
    packed = pb.TellSamplesRequest.FromString(proto.telling_to_proto("s", "c", telling).SerializeToString())
    assert (packed.session_id, packed.scan_id) == ("s", "c")
    assert same(telling, proto.telling_from_proto(packed))
    assert same(telling, telling_from_json(through_json(telling_to_json(telling))))


@given(st.builds(ScanProgress, counts, st.booleans(), shares, shares))
def test_both_wires_give_a_progress_back(progress: ScanProgress) -> None:
    packed = pb.ScanProgress.FromString(proto.progress_to_proto(progress).SerializeToString())
    assert same(progress, proto.progress_from_proto(packed))
    assert same(progress, progress_from_json(through_json(progress_to_json(progress))))


def test_a_chunk_without_samples_asks_for_the_progress() -> None:
    got = proto.telling_from_proto(pb.TellSamplesRequest(chunk=pb.SampleChunk()))
    assert isinstance(got, SampleChunk)
    assert (got.start, len(got.samples)) == (0, 0)


def test_a_request_left_bare_takes_the_same_defaults_on_both_wires() -> None:
    bare = SessionRequest(Camera(525, 525, 319.5, 239.5), Pose.identity())
    document = {
        "camera": {"fx": 525, "fy": 525, "cx": 319.5, "cy": 239.5},
        "base_T_camera": {"translation": [0, 0, 0], "rotation": [0, 0, 0, 1]},
    }
    message = pb.CreateSessionRequest(
        camera=common_pb2.Camera(fx=525, fy=525, cx=319.5, cy=239.5),
        base_t_camera=common_pb2.Pose(matrix=np.eye(4).ravel()),
        depth=common_pb2.Array(data=b"\0\0", shape=[1, 1], type=common_pb2.SCALAR_TYPE_UINT16),
    )
    assert same(bare, request_from_json(document))
    got, _, mask = proto.request_from_proto(message)
    assert same(bare, got)
    assert mask is None


def _packed(values: np.ndarray, number: int) -> common_pb2.Array:
    return common_pb2.Array(data=values.tobytes(), shape=values.shape, type=number)  # type: ignore[arg-type]


def _samples(**changes: Any) -> pb.SubmitScanRequest:
    good: dict[str, Any] = {
        "t": np.arange(2.0),
        "base_t_tip": np.tile(np.eye(4), (2, 1, 1)),
        "range": np.array([0.03, np.nan]),
    }
    columns = {name: _packed(values, common_pb2.SCALAR_TYPE_FLOAT64) for name, values in (good | changes).items()}
    codes = {name: _packed(np.zeros(2, np.uint8), common_pb2.SCALAR_TYPE_UINT8) for name in ("status", "module")}
    return pb.SubmitScanRequest(samples=common_pb2.Samples(**(codes | columns)))


@pytest.mark.parametrize(
    ("message", "error", "words"),
    [
        (pb.SubmitScanRequest(), InvalidInput, "no result"),
        (_samples(t=np.array([1.0, 0.0])), InvalidInput, r"samples\[1\]\.t"),
        (_samples(t=np.array([0.0, np.nan])), Malformed, "NaN"),
        (_samples(range=np.array([0.03, -0.01])), InvalidInput, r"samples\[1\]\.range"),
        (_samples(range=np.array([0.03, np.inf])), Malformed, "range"),
        (_samples(base_t_tip=np.tile(2 * np.eye(4), (2, 1, 1))), InvalidInput, r"samples\[0\]\.base_T_tip"),
        (_samples(status=np.array([0.5, 0.5])), InvalidInput, "UINT8"),
        (pb.SubmitScanRequest(points=pb.Points(points=_packed(np.zeros((0, 3)), 4))), InvalidInput, "empty"),
        (pb.SubmitScanRequest(points=pb.Points(points=_packed(np.zeros((2, 2)), 4))), InvalidInput, "shape"),
        (pb.SubmitScanRequest(points=pb.Points(points=_packed(np.full((2, 3), np.nan), 4))), Malformed, "NaN"),
        (
            pb.SubmitScanRequest(points=pb.Points(points=_packed(np.zeros((MAX_SAMPLES + 1, 3)), 4))),
            TooLarge,
            "20001 points",
        ),
        (pb.SubmitScanRequest(gateway=pb.GatewaySpan(device="finger")), InvalidInput, r"gateway\.to"),
        (pb.SubmitScanRequest(skipped=pb.Skipped(reason="bored")), InvalidInput, "bored"),
    ],
)
def test_a_bad_scan_message_is_refused_with_its_reason(
    message: pb.SubmitScanRequest, error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words) as caught:
        proto.submission_from_proto(message)
    assert type(caught.value) is error


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda message: message.ClearField("camera"), "camera is missing"),
        (lambda message: message.ClearField("depth"), "depth is missing"),
        (lambda message: message.ClearField("base_t_camera"), "base_t_camera is missing"),
        (lambda message: message.base_t_camera.matrix.pop(), "15 numbers"),
        (lambda message: message.table.SetInParent(), "table"),
        (lambda message: setattr(message, "proposer", "best"), "proposer"),
        (lambda message: setattr(message, "planner", "best"), "planner"),
        (lambda message: setattr(message.tolerance, "error", -1), r"tolerance\.error"),
        (lambda message: setattr(message.budget, "scans", 0), r"budget\.scans"),
        (lambda message: setattr(message.scan, "standoff", 5), r"scan\.standoff"),
        (lambda message: setattr(message, "depth_scale", 0), r"camera\.depth_scale"),
        (lambda message: message.roi.SetInParent(), "roi"),
    ],
)
def test_a_bad_request_message_is_refused_with_its_reason(
    change: Callable[[pb.CreateSessionRequest], object], words: str
) -> None:
    request = SessionRequest(Camera(525, 525, 319.5, 239.5), Pose.identity())
    message = proto.request_to_proto(request, np.ones((2, 2), np.float32))
    change(message)
    with pytest.raises(InvalidInput, match=words) as caught:
        proto.request_from_proto(message)
    assert caught.value.remedy
