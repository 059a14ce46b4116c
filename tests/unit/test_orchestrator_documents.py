"""The described REST documents are those that the wire module reads and writes; JSON is parsed strictly."""

from __future__ import annotations

import json as text
import re
from dataclasses import asdict

import pytest
from helpers import box_view
from helpers.openapi_document import openapi_document
from helpers.records import a_record, after_a_scan
from hypothesis import given
from hypothesis import strategies as st
from pretouch_orchestrator.rest import models as documents
from pretouch_orchestrator.rest.bodies import parse_json
from pydantic import TypeAdapter

from pretouch.errors import Malformed
from pretouch.prior import Prior
from pretouch.session import Budget, GatewaySpan, ScanSettings, Skipped, Tolerance
from pretouch.tof import Sensor
from pretouch.wire import json


def test_described_defaults_are_the_types_own() -> None:
    pairs = (
        (documents.Budget, Budget),
        (documents.Prior, Prior),
        (documents.Tolerance, Tolerance),
        (documents.ScanSettings, ScanSettings),
    )
    for model, kind in pairs:
        assert model().model_dump() == asdict(kind())
    sensor = documents.Sensor().model_dump(exclude={"tip_T_module"})
    assert sensor == {name: getattr(Sensor(), name) for name in sensor}
    request = json.request_from_json({name: box_view.request()[name] for name in ("camera", "base_T_camera")})
    assert documents.SessionRequest.model_fields["planner"].default == request.planner
    camera = {name: box_view.request()["camera"][name] for name in ("fx", "fy", "cx", "cy")}
    bare = json.request_from_json(box_view.request() | {"camera": camera})
    assert documents.Camera(**camera).depth_scale == bare.depth_scale


def test_requests_as_written_are_as_described() -> None:
    document = json.request_to_json(a_record().request)
    assert documents.SessionRequest.model_validate(document).model_dump(mode="json", exclude_unset=True) == document


@pytest.mark.parametrize("record", [a_record(), after_a_scan(a_record())])
def test_sessions_as_answered_are_as_described(record: object) -> None:
    document = json.session_to_json(record.to_session())  # type: ignore[attr-defined]
    assert documents.Session.model_validate(document).model_dump(mode="json", exclude_unset=True) == document


def test_scans_as_sent_are_as_described() -> None:
    plan = json.scan_plan_to_json(a_record().next_scan)  # type: ignore[arg-type]
    samples = json.submission_from_json(box_view.samples(plan))
    adapter: TypeAdapter[object] = TypeAdapter(documents.Submission)
    for submission in (samples, GatewaySpan("finger", 1.0, 2.5), Skipped(), Skipped(samples)):  # type: ignore[arg-type]
        document = json.submission_to_json(submission)  # type: ignore[arg-type]
        described = adapter.dump_python(
            adapter.validate_python(document), mode="json", exclude_unset=True, by_alias=True
        )
        assert described == document


def test_the_description_refers_only_to_what_it_holds() -> None:
    document = openapi_document(token="t")
    referred = set(re.findall(r'"#/components/schemas/(\w+)"', text.dumps(document)))
    assert referred <= set(document["components"]["schemas"])
    assert {"Session", "SessionRequest", "Submission", "Problem"} <= referred
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            assert all(response["description"] for response in operation["responses"].values()), (method, path)
            assert ("401" in operation["responses"]) == path.startswith("/v1"), (method, path)


@given(st.binary(max_size=200) | st.text(max_size=100).map(str.encode))
def test_any_bytes_are_json_or_malformed(data: bytes) -> None:
    try:
        document = parse_json(data, "The body")
    except Malformed:
        return
    assert text.loads(data) == document


@pytest.mark.parametrize("data", [b"NaN", b"[Infinity]", b'{"a": -Infinity}', b'"\\ud800"', b"[" * 99_999, b"9" * 9999])
def test_what_is_not_json_is_malformed(data: bytes) -> None:
    with pytest.raises(Malformed, match="The body is not JSON"):
        parse_json(data, "The body")
