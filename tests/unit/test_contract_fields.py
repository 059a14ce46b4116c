"""Dataclass, message, JSON and OpenAPI schema agree on the session contract: fields, words, units and defaults."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import pytest
from google.protobuf.descriptor import Descriptor
from helpers.openapi_document import openapi_document
from helpers.proto_comments import field_comments
from pretouch_orchestrator.rest import camera_examples, examples

from pretouch.calibrated_camera import (
    CalibratedCamera,
    CalibrationDrift,
    CalibrationResidual,
    CameraSession,
    CameraSummary,
    LeftOutSession,
)
from pretouch.camera import Camera
from pretouch.estimate import Estimate, Mode, WeakDirection
from pretouch.geometry import Plane
from pretouch.prior import PosePrior, Prior
from pretouch.rectangle import RotatedRectangle
from pretouch.session import (
    Budget,
    BudgetUsed,
    GatewaySpan,
    Points,
    Region,
    SampleChunk,
    ScanPlan,
    ScanProgress,
    ScanSettings,
    ScanSummary,
    Session,
    SessionRequest,
    Skipped,
    Tolerance,
)
from pretouch.session_warning import SessionWarning
from pretouch.tof import RangeSamples, Sensor
from pretouch.v1 import calibrated_camera_pb2, common_pb2, orchestrator_pb2
from pretouch.wire.contract import ContractField, contract_fields

_REQUEST, _CONVERGED = examples.COMPLETE_REQUEST, examples.CONVERGED
_SUBMISSIONS = examples.SUBMISSIONS
UNITS = re.compile(r"metres per second|metres|radians|seconds|pixels|hertz|in base|Unix epoch|z along", re.IGNORECASE)
"""Units and frames, as every description names them."""


class Contract(NamedTuple):
    """A type of the contract in its four forms.

    `in_message` and `in_json` say where these differ from the dataclass: "-name" is not there, "+name" is there only.
    """

    owner: type
    message: Descriptor
    schema: str = ""
    document: dict[str, Any] | None = None
    in_message: str = ""
    in_json: str = ""


DERIVED = [
    Contract(
        Camera, common_pb2.Camera.DESCRIPTOR, "Camera", _REQUEST["camera"], in_json="+depth_scale +width +height +id"
    ),
    Contract(Plane, common_pb2.Plane.DESCRIPTOR, "Plane", _REQUEST["table"]),
    Contract(Prior, common_pb2.Prior.DESCRIPTOR, "Prior", _REQUEST["prior"]),
    Contract(PosePrior, common_pb2.PosePrior.DESCRIPTOR, "PosePrior", examples.POSE_PRIOR),
    Contract(Tolerance, orchestrator_pb2.Tolerance.DESCRIPTOR, "Tolerance", _REQUEST["tolerance"]),
    Contract(Budget, orchestrator_pb2.Budget.DESCRIPTOR, "Budget", _REQUEST["budget"]),
    Contract(Sensor, common_pb2.Sensor.DESCRIPTOR, "Sensor", _REQUEST["sensor"]),
    Contract(ScanSettings, orchestrator_pb2.ScanSettings.DESCRIPTOR, "ScanSettings", _REQUEST["scan"]),
    Contract(
        Estimate,
        common_pb2.Estimate.DESCRIPTOR,
        "Estimate",
        _CONVERGED["estimate"],
        in_json="-sensor_problem -engine +base_T_object",
    ),
    Contract(
        WeakDirection, common_pb2.WeakDirection.DESCRIPTOR, "WeakDirection", _CONVERGED["estimate"]["unobservable"][0]
    ),
    Contract(Mode, common_pb2.Mode.DESCRIPTOR, "Mode", _CONVERGED["estimate"]["modes"][0]),
    Contract(RotatedRectangle, common_pb2.Rectangle.DESCRIPTOR),
    Contract(Region, orchestrator_pb2.Region.DESCRIPTOR, "Region", _CONVERGED["regions"][0]),
    Contract(ScanSummary, orchestrator_pb2.ScanSummary.DESCRIPTOR, "ScanSummary", _CONVERGED["scans"][0]),
    Contract(ScanProgress, orchestrator_pb2.ScanProgress.DESCRIPTOR, "ScanProgress", examples.PROGRESS),
    Contract(
        SessionWarning,
        orchestrator_pb2.SessionWarning.DESCRIPTOR,
        "SessionWarning",
        _CONVERGED["warnings"][0],
    ),
    *(
        Contract(
            owner, calibrated_camera_pb2.DESCRIPTOR.message_types_by_name[owner.__name__], owner.__name__, document
        )
        for owner, document in (
            (CalibratedCamera, camera_examples.CAMERA),
            (CameraSummary, camera_examples.CAMERA_LIST["cameras"][0]),
            (CalibrationResidual, camera_examples.CAMERA["residual"]),
            (CalibrationDrift, camera_examples.CAMERA["drift"]),
            (CameraSession, camera_examples.CAMERA["history"][0]),
            (LeftOutSession, camera_examples.CAMERA["left_out"][0]),
        )
    ),
    Contract(BudgetUsed, orchestrator_pb2.BudgetUsed.DESCRIPTOR, "BudgetUsed", _CONVERGED["budget_used"]),
]
"""Types whose message, JSON and schema are derived from the dataclass."""
WRITTEN = [
    Contract(
        SessionRequest,
        orchestrator_pb2.CreateSessionRequest.DESCRIPTOR,
        "SessionRequest",
        _REQUEST | {"proposer": "deep"},
        in_message="+depth +mask +idempotency_key +pose_prior",
        in_json="-depth_scale -width -height -camera_id",
    ),
    Contract(
        Session,
        orchestrator_pb2.Session.DESCRIPTOR,
        "Session",
        _CONVERGED | {"reason": examples.PROBLEMS[409]},
        in_json="-base_T_object",
    ),
    Contract(
        ScanPlan,
        orchestrator_pb2.ScanPlan.DESCRIPTOR,
        "ScanPlan",
        examples.SCAN_PLAN,
        in_message="-path +t +base_t_tip +length +duration",
        in_json="-path +waypoints +length +duration",
    ),
    Contract(RangeSamples, common_pb2.Samples.DESCRIPTOR, "Sample", _SUBMISSIONS["samples"]["samples"][0]),
    Contract(Points, orchestrator_pb2.Points.DESCRIPTOR, "Points", _SUBMISSIONS["points"]),
    Contract(
        SampleChunk,
        orchestrator_pb2.SampleChunk.DESCRIPTOR,
        "SampleChunk",
        examples.TELLINGS["chunk"],
        in_message="-start +from",
        in_json="-start +from",
    ),
    Contract(
        GatewaySpan,
        orchestrator_pb2.GatewaySpan.DESCRIPTOR,
        "Span",
        _SUBMISSIONS["gateway"]["gateway"],
        in_message="-start -end +from +to",
        in_json="-start -end +from +to",
    ),
    Contract(
        Skipped,
        orchestrator_pb2.Skipped.DESCRIPTOR,
        "Skipped",
        _SUBMISSIONS["skipped"] | _SUBMISSIONS["samples"],
        in_json="-reason +skipped",
    ),
]
"""Types whose conversions are written by hand."""
OWN_WORDS = {"proposer", "planner", "reason"}
"""Fields whose values differ in form, and so in their description."""
SCHEMAS: dict[str, Any] = openapi_document()["components"]["schemas"]

every_contract = pytest.mark.parametrize("contract", DERIVED + WRITTEN, ids=lambda contract: contract.owner.__name__)


@pytest.fixture(scope="module")
def comments(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, str]]:
    return field_comments(tmp_path_factory.mktemp("protoc"))


def changed(names: set[str], changes: str) -> set[str]:
    """`names` with and without what `changes` says."""
    for change in changes.split():
        if change[0] == "+":
            assert change[1:] not in names
            names = names | {change[1:]}
        else:
            assert change[1:] in names
            names = names - {change[1:]}
    return names


def _write(default: float | bool) -> str:
    return str(default).lower() if isinstance(default, bool) else f"{default:g}"


def shared_fields(contract: Contract) -> Iterator[tuple[ContractField, str]]:
    """The fields that the message has too, with their names there."""
    for field in contract_fields(contract.owner):
        if field.name.lower() in contract.message.fields_by_name:
            yield field, field.name.lower()


@every_contract
def test_every_form_has_the_same_fields(contract: Contract) -> None:
    names = {field.name for field in dataclasses.fields(contract.owner)}
    in_message = changed({name.lower() for name in names}, contract.in_message)
    assert set(contract.message.fields_by_name) == in_message
    if contract.document is not None:
        in_json = changed(names, contract.in_json)
        assert set(SCHEMAS[contract.schema]["properties"]) == in_json
        assert set(contract.document) == in_json


@every_contract
def test_every_field_is_described(contract: Contract, comments: dict[str, dict[str, str]]) -> None:
    assert [field.name for field in contract_fields(contract.owner) if not field.description] == []
    own = comments[contract.message.name]
    assert [name for name in contract.message.fields_by_name if not own[name]] == []


@pytest.mark.parametrize("contract", DERIVED + WRITTEN[:2], ids=lambda contract: contract.owner.__name__)
def test_a_field_has_the_same_words_and_default_in_every_form(
    contract: Contract, comments: dict[str, dict[str, str]]
) -> None:
    properties = SCHEMAS[contract.schema]["properties"] if contract.schema else {}
    for field, name in shared_fields(contract):
        if field.name in OWN_WORDS:
            continue
        comment, _, default = comments[contract.message.name][name].partition(" Left out: ")
        assert comment.casefold() == field.description.casefold()
        has_presence = contract.message.fields_by_name[name].has_presence
        optional = has_presence and isinstance(field.default, float | int)
        if isinstance(field.default, float | int) and field.default != 0:
            assert has_presence, f"{name} = 0 and {name} left out would be the same"
        assert default == (f"{_write(field.default)}." if optional else "")
        if field.name in properties:
            assert properties[field.name]["description"].casefold() == field.description.casefold()


@pytest.mark.parametrize("contract", WRITTEN[2:], ids=lambda contract: contract.owner.__name__)
def test_a_field_of_another_form_has_the_same_units_and_frame(
    contract: Contract, comments: dict[str, dict[str, str]]
) -> None:
    properties = SCHEMAS[contract.schema]["properties"]
    for field, name in shared_fields(contract):
        units = set(UNITS.findall(field.description))
        assert set(UNITS.findall(comments[contract.message.name][name])) == units, field.name
        if field.name in properties and field.name != "samples":
            assert set(UNITS.findall(properties[field.name]["description"])) == units, field.name


@pytest.mark.parametrize("name", ["Prior", "Tolerance", "Budget", "Sensor", "ScanSettings", "SessionRequest"])
def test_the_defaults_of_a_request_are_those_of_its_type(name: str) -> None:
    schema = SCHEMAS[name]
    (contract,) = (contract for contract in DERIVED + WRITTEN if contract.schema == name)
    fields = [field for field in contract_fields(contract.owner) if field.name in schema["properties"]]
    described = {member: value["default"] for member, value in schema["properties"].items() if "default" in value}
    assert described == {
        field.name: field.default for field in fields if field.default not in (None, dataclasses.MISSING)
    }
    assert schema.get("required", []) == [field.name for field in fields if field.required]


def test_the_tip_frame_is_named_wherever_the_tips_pose_is(comments: dict[str, dict[str, str]]) -> None:
    described = [(name, fields["base_t_tip"]) for name, fields in comments.items() if "base_t_tip" in fields]
    for name, schema in SCHEMAS.items():
        if "base_T_tip" in schema.get("properties", {}):
            described.append((name, schema["properties"]["base_T_tip"]["description"]))
    assert len(described) >= 6
    assert [name for name, text in described if "in base" not in text or "z along" not in text] == []
