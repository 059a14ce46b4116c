"""The JSON of the REST contract is read strictly, and each refusal names the member and what to do."""

import copy
import json
import math
from typing import Any

import numpy as np
import pytest

from pretouch.camera import Camera
from pretouch.errors import InvalidInput, Malformed, TooLarge
from pretouch.geometry import Pose
from pretouch.prior import Prior
from pretouch.session import SessionRequest, Skipped
from pretouch.tof import MAX_SAMPLES, RangeSamples
from pretouch.wire.json import request_from_json, request_to_json, submission_from_json, submission_to_json

_POSE = {"translation": [0, 0, 0], "rotation": [0, 0, 0, 1]}
_SAMPLE = {"t": 0, "base_T_tip": _POSE, "range": 0.03, "status": 0}
_REQUEST = request_to_json(
    SessionRequest(
        Camera(525, 525, 319.5, 239.5),
        Pose.identity(),
        roi=(0, 0, 640, 480),
        base_T_object=Pose.identity(),
        prior=Prior(),
    )
) | {"table": {"normal": [0, 0, 1], "offset": 0}}


def changed(document: Any, path: str, value: object) -> Any:
    """A copy of `document` whose member at the dotted `path` is `value`."""
    result = copy.deepcopy(document)
    *parents, last = [int(step) if step.isdigit() else step for step in path.split(".")]
    owner = result
    for step in parents:
        owner = owner[step]
    owner[last] = value
    return result


@pytest.mark.parametrize("value", [None, "1", True, [], {}])
@pytest.mark.parametrize(
    "path",
    [
        *("camera.fx", "camera.depth_scale", "base_T_camera.rotation.3", "table.normal.0", "table.offset", "roi.0"),
        *("prior.rotation_std", "tolerance.error", "budget.scans", "budget.seconds", "sensor.rate", "scan.speed"),
    ],
)
def test_a_member_that_is_not_a_number_is_refused_by_its_path(path: str, value: object) -> None:
    name = path.replace(".0", "[0]").replace(".3", "[3]")
    with pytest.raises(InvalidInput) as caught:
        request_from_json(changed(_REQUEST, path, value))
    assert type(caught.value) is InvalidInput
    assert name in caught.value.detail
    assert caught.value.remedy


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 10**400])
@pytest.mark.parametrize("path", ["camera.fx", "base_T_object.translation.1", "sensor.range_std", "roi.2"])
def test_a_number_that_is_not_finite_is_malformed(path: str, value: float) -> None:
    with pytest.raises(Malformed, match="finite"):
        request_from_json(changed(_REQUEST, path, value))


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("camera", None, "camera is null"),
        ("camera", [525], "camera is a list"),
        ("camera.k1", 0, "camera.k1 is not a known member"),
        ("colour", "red", "colour is not a known member"),
        ("camera.fx", 0, "focal"),
        ("base_T_camera.rotation", [0, 0, 0, 2], "base_T_camera: .*norm 2"),
        ("base_T_camera.rotation", [0, 0, 1], "base_T_camera.rotation has 3 items"),
        ("table.normal", [0, 0, 2], "table: .*norm 2"),
        ("roi", [0, 0, 1.5, 2], r"roi\[2\] is 1.5"),
        ("roi", [4, 0, 4, 2], "roi"),
        ("roi", [0, 0, 1, 10**12], r"roi\[3\]"),
        ("camera.fx", 1e-9, "focal lengths"),
        ("camera.cy", 1e300, "camera.cy holds 1e\\+300"),
        ("base_T_camera.translation.1", -1e300, "base_T_camera holds -1e\\+300"),
        ("base_T_object.translation.1", 1e9, "base_T_object"),
        ("sensor.tip_T_module.0.translation.2", 1e300, r"sensor.tip_T_module\[0\]"),
        ("table.offset", 1e300, "table.offset"),
        ("roi", None, "roi is null"),
        ("prior", None, "prior is null"),
        ("prior.rotation_std", 0, "prior.rotation_std"),
        ("tolerance.confidence", 1, "tolerance.confidence"),
        ("budget.scans", 2.5, "budget.scans"),
        ("budget.fraction", 2, "budget.fraction"),
        ("sensor.range_max", 0.001, "sensor.range_max"),
        ("sensor.tip_T_module", [], "sensor.tip_T_module"),
        ("sensor.tip_T_module", [_POSE, None], r"sensor.tip_T_module\[1\] is null"),
        ("scan.standoff", 0.5, "scan.standoff"),
        ("scan.speed", 5e-324, "scan.speed"),
        ("scan.guarded", 1, "scan.guarded is a number, not a boolean"),
        ("scan.guarded", "true", "scan.guarded is a string, not a boolean"),
        ("proposer", "best", "proposer is 'best'"),
        ("proposer", None, "proposer is null"),
        ("planner", 3, "planner is a number"),
    ],
)
def test_a_bad_request_is_refused_with_its_reason(path: str, value: object, words: str) -> None:
    with pytest.raises(InvalidInput, match=words) as caught:
        request_from_json(changed(_REQUEST, path, value))
    assert type(caught.value) is InvalidInput
    assert caught.value.remedy


@pytest.mark.parametrize("name", ["camera", "base_T_camera"])
def test_a_missing_member_is_named(name: str) -> None:
    with pytest.raises(InvalidInput, match=f"{name} is missing"):
        request_from_json({key: value for key, value in _REQUEST.items() if key != name})


@pytest.mark.parametrize("document", [None, [], "x", 3])
def test_a_document_that_is_not_an_object_is_refused(document: object) -> None:
    with pytest.raises(InvalidInput, match="not an object"):
        request_from_json(document)
    with pytest.raises(InvalidInput, match="not an object"):
        submission_from_json(document)


def test_a_whole_number_may_be_written_with_a_point() -> None:
    assert request_from_json(changed(_REQUEST, "budget.scans", 3.0)).budget.scans == 3


@pytest.mark.parametrize(
    ("document", "error", "words"),
    [
        ({}, InvalidInput, "none of"),
        ({"samples": [_SAMPLE], "points": [[0, 0, 0]]}, InvalidInput, "samples, points"),
        ({"points": []}, InvalidInput, "points is empty"),
        ({"samples": None}, InvalidInput, "samples is null"),
        ({"samples": [None]}, InvalidInput, r"samples\[0\] is null"),
        ({"samples": [_SAMPLE, {"t": 1}]}, InvalidInput, r"samples\[1\]\.base_T_tip is missing"),
        ({"samples": [_SAMPLE | {"colour": 1}]}, InvalidInput, r"samples\[0\]\.colour"),
        ({"samples": [_SAMPLE | {"t": 1}, _SAMPLE]}, InvalidInput, r"samples\[1\]\.t"),
        ({"samples": [_SAMPLE | {"t": None}]}, InvalidInput, r"samples\[0\]\.t is null"),
        ({"samples": [_SAMPLE | {"t": math.nan}]}, Malformed, r"samples\[0\]\.t"),
        ({"samples": [_SAMPLE | {"t": 1e300}]}, InvalidInput, r"samples\.t"),
        ({"points": [[0, 0, 1e300]]}, InvalidInput, r"points holds 1e\+300"),
        ({"gateway": {"device": "finger", "from": -1e300, "to": 1}}, InvalidInput, r"gateway\.from"),
        ({"samples": [_SAMPLE, _SAMPLE | {"range": "x"}]}, InvalidInput, r"samples\[1\]\.range"),
        ({"samples": [_SAMPLE | {"range": -0.01}]}, InvalidInput, r"samples\[0\]\.range"),
        ({"samples": [_SAMPLE | {"range": math.inf}]}, Malformed, r"samples\[0\]\.range"),
        ({"samples": [_SAMPLE | {"status": 1.5}]}, InvalidInput, r"samples\[0\]\.status"),
        ({"samples": [_SAMPLE | {"status": None}]}, InvalidInput, r"samples\[0\]\.status is null"),
        ({"samples": [_SAMPLE | {"module": 256}]}, InvalidInput, r"samples\[0\]\.module"),
        (
            {"samples": [_SAMPLE, _SAMPLE | {"base_T_tip": {"translation": [0, 0, 0], "rotation": [0, 0, 0, 0.5]}}]},
            InvalidInput,
            r"samples\[1\]\.base_T_tip",
        ),
        (
            {"samples": [_SAMPLE | {"base_T_tip": {"translation": [0, math.nan, 0], "rotation": [0, 0, 0, 1]}}]},
            Malformed,
            r"samples\[0\]\.base_T_tip\.translation\[1\]",
        ),
        ({"samples": [_SAMPLE | {"base_T_tip": None}]}, InvalidInput, r"samples\[0\]\.base_T_tip is null"),
        ({"samples": [_SAMPLE] * (MAX_SAMPLES + 1)}, TooLarge, "20001"),
        ({"points": [[0, 0, 0], [0, 0]]}, InvalidInput, r"points\[1\] has 2 items"),
        ({"points": [[0, 0, True]]}, InvalidInput, r"points\[0\]\[2\] is a boolean"),
        ({"points": [[0, 0, math.nan]]}, Malformed, r"points\[0\]\[2\]"),
        ({"points": [[0, 0, 0]] * (MAX_SAMPLES + 1)}, TooLarge, "20001"),
        ({"gateway": {"device": "finger", "from": 1}}, InvalidInput, r"gateway\.to is missing"),
        ({"gateway": {"device": "finger", "from": 2, "to": 1}}, InvalidInput, r"gateway\.to"),
        ({"gateway": {"device": 3, "from": 1, "to": 2}}, InvalidInput, r"gateway\.device"),
        ({"skipped": "bored"}, InvalidInput, "bored"),
        ({"skipped": None}, InvalidInput, "skipped is null"),
    ],
)
def test_a_bad_scan_is_refused_with_its_reason(document: object, error: type[InvalidInput], words: str) -> None:
    with pytest.raises(error, match=words) as caught:
        submission_from_json(document)
    assert type(caught.value) is error
    assert caught.value.remedy


def test_a_missing_range_is_null_and_codes_default_to_zero() -> None:
    got = submission_from_json({"samples": [{"t": 0, "base_T_tip": _POSE, "range": None}]})
    assert isinstance(got, RangeSamples)
    assert np.isnan(got.range).all()
    assert (got.status[0], got.module[0]) == (0, 0)
    assert submission_to_json(got)["samples"][0]["range"] is None


def test_a_skipped_scan_may_carry_no_samples_or_some() -> None:
    bare = submission_from_json({"skipped": "unreachable"})
    assert isinstance(bare, Skipped)
    assert bare.samples is None
    some = submission_from_json({"skipped": "unreachable", "samples": [_SAMPLE]})
    assert isinstance(some, Skipped)
    assert some.samples is not None
    assert len(some.samples) == 1


def test_a_full_scan_keeps_its_numbers() -> None:
    turns = np.random.default_rng(0).normal(size=(MAX_SAMPLES, 3))
    poses = np.tile(Pose.from_rotation_vector([0.1, 0.2, 0.3], [0, 0, 0]).matrix, (MAX_SAMPLES, 1, 1))
    poses[:, :3, 3] = turns
    ranges = np.abs(turns[:, 0])
    zeros = np.zeros(MAX_SAMPLES, np.int64)
    samples = RangeSamples(np.arange(MAX_SAMPLES) / 30, poses, ranges, zeros, zeros)
    got = submission_from_json(json.loads(json.dumps(submission_to_json(samples))))
    assert isinstance(got, RangeSamples)
    np.testing.assert_array_equal(got.range, ranges)
    np.testing.assert_allclose(got.base_T_tip, poses, atol=1e-12)
