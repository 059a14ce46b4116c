"""A camera's exported pose says what the camera says, in every format."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pretouch_orchestrator.rest import camera_examples

from pretouch.calibrated_camera import CalibratedCamera, CalibrationDrift, check_camera_id
from pretouch.camera_export import ExportFormat, export_camera, roll_pitch_yaw
from pretouch.errors import Conflict, InvalidInput
from pretouch.geometry import Pose, rotation_from_vector
from pretouch.wire.json import camera_from_json

CAMERA = camera_from_json(camera_examples.CAMERA)
angles = st.floats(-3.1, 3.1)


def named(name: str, pose: Pose = CAMERA.base_T_camera) -> CalibratedCamera:
    return replace(CAMERA, id=name, base_T_camera=pose)


def rotation_of(rpy: list[float]) -> np.ndarray:
    roll, pitch, yaw = (rotation_from_vector(axis * angle) for axis, angle in zip(np.eye(3), rpy, strict=True))
    return np.asarray(yaw @ pitch @ roll)


@given(st.tuples(angles, angles, angles))
def test_roll_pitch_and_yaw_are_those_of_the_rotation(vector: tuple[float, float, float]) -> None:
    rotation = rotation_from_vector(vector)
    np.testing.assert_allclose(rotation_of(list(roll_pitch_yaw(rotation))), rotation, atol=1e-7)


@given(angles, angles, st.sampled_from([-np.pi / 2, np.pi / 2]))
def test_a_pitch_of_a_right_angle_is_written_too(roll: float, yaw: float, pitch: float) -> None:
    rotation = rotation_of([roll, pitch, yaw])
    np.testing.assert_allclose(rotation_of(list(roll_pitch_yaw(rotation))), rotation, atol=1e-7)


@pytest.mark.parametrize("name", ["head", "a--b-", "1.0", "null", "-"])
def test_every_format_holds_the_pose(name: str) -> None:
    camera = named(name)
    document = json.loads(export_camera(camera, ExportFormat.JSON))
    assert document["camera"] == name
    pose = Pose.from_quaternion(document["base_T_camera"]["translation"], document["base_T_camera"]["rotation"])
    assert pose.is_close(camera.base_T_camera, 1e-9)
    np.testing.assert_array_equal(document["covariance"], camera.base_T_camera_covariance)

    joint = ElementTree.fromstring(export_camera(camera, ExportFormat.URDF).partition("-->")[2])
    origin = joint.find("origin")
    assert origin is not None
    xyz, rpy = ([float(value) for value in origin.attrib[key].split()] for key in ("xyz", "rpy"))
    assert Pose.of(rotation_of(rpy), xyz).is_close(camera.base_T_camera, 1e-8)
    ElementTree.fromstring(f"<robot>{export_camera(camera, ExportFormat.URDF)}</robot>")

    text = export_camera(camera, ExportFormat.YAML)
    assert f"camera: {json.dumps(name)}\n" in text
    translation = re.search(r"translation: (.*)", text)
    assert translation is not None
    assert json.loads(translation[1]) == document["base_T_camera"]["translation"]
    rows = [json.loads(row) for row in re.findall(r"^  - (.*)$", text, re.MULTILINE)]
    assert rows == document["covariance"]


@pytest.mark.parametrize("state", ["steady", "moved"])
@pytest.mark.parametrize("format", list(ExportFormat))
def test_what_is_not_known_is_not_exported(state: str, format: ExportFormat) -> None:
    camera = replace(CAMERA, base_T_camera_covariance=None, drift=CalibrationDrift(state, None))
    with pytest.raises(Conflict, match="head") as caught:
        export_camera(camera, format)
    assert caught.value.remedy


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "a b", "é", "x" * 65, "a\n", "a%2e", "\0"])
def test_what_is_no_name_is_refused(name: str) -> None:
    with pytest.raises(InvalidInput, match=r"camera\.id"):
        check_camera_id(name)


@given(st.from_regex(r"[A-Za-z0-9._-]{1,64}", fullmatch=True).filter(lambda name: name not in (".", "..")))
def test_every_name_of_the_contract_is_one(name: str) -> None:
    assert check_camera_id(name) == name
