"""Every invalid creation gets an error with a remedy, the same over REST and gRPC."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import numpy as np
import pytest
from google.protobuf.message import Message
from helpers.box_session import DEPTH, MASK, TOKEN
from helpers.box_view import png
from helpers.creation import FULL, changed, files, image, message, npy, set_field, with_depth, with_roi, without
from helpers.problems import TIMEOUT, check, code_of, over_grpc, over_rest
from helpers.processes import Orchestrator

from pretouch.errors import (
    InvalidInput,
    Malformed,
    PretouchError,
    TooLarge,
    Unauthenticated,
    Unavailable,
    UnsupportedMedia,
)
from pretouch.v1 import orchestrator_pb2 as pb
from pretouch.wire.json import request_to_json
from pretouch.wire.session import request_to_proto

LEANING = (0.0, 0.0, 0.7, 0.7)  # a quaternion of norm 0.99


@dataclasses.dataclass(frozen=True)
class Bad:
    """A bad request on both wires, and the error that it deserves, with a word of its detail."""

    kind: type[PretouchError]
    word: str
    rest: Callable[[], dict[str, Any]]
    grpc: Callable[[], pb.CreateSessionRequest]


BAD = {
    "mask of another size": Bad(
        InvalidInput,
        "mask",
        lambda: files(mask=png(image((100, 100), 255))),
        lambda: message(mask=image((100, 100), 255)),
    ),
    "depth of another size": Bad(
        InvalidInput,
        "100 x 100",
        lambda: files(depth=png(image((100, 100), 7000, np.uint16))),
        lambda: message(depth=image((100, 100), 7000, np.uint16)),
    ),
    "no depth at all": Bad(
        InvalidInput,
        "depth",
        lambda: files(depth=png(np.zeros_like(DEPTH))),
        lambda: message(depth=np.zeros_like(DEPTH)),
    ),
    "mask without pixels": Bad(
        InvalidInput,
        "mask is empty",
        lambda: files(mask=png(image(MASK.shape, 0))),
        lambda: message(mask=image(MASK.shape, 0)),
    ),
    "roi beside the object": Bad(
        InvalidInput,
        "roi",
        lambda: files(changed("roi", [0, 0, 20, 20])),
        lambda: with_roi(0, 0, 20, 20),
    ),
    "roi inside out": Bad(
        InvalidInput, "roi", lambda: files(changed("roi", [20, 0, 10, 20])), lambda: with_roi(20, 0, 10, 20)
    ),
    "NaN focal length": Bad(
        Malformed, "", lambda: files(changed("camera.fx", np.nan)), lambda: set_field("camera.fx", np.nan)
    ),
    "negative focal length": Bad(
        InvalidInput, "focal", lambda: files(changed("camera.fy", -525)), lambda: set_field("camera.fy", -525)
    ),
    "rotation that is none": Bad(
        InvalidInput,
        "base_t_camera",
        lambda: files(changed("base_T_camera.rotation", LEANING)),
        lambda: set_field("base_t_camera.matrix.0", 2.0),
    ),
    "normal that is not unit": Bad(
        InvalidInput,
        "table",
        lambda: files(changed("table.normal", [0, 0, 2])),
        lambda: set_field("table.normal.2", 2.0),
    ),
    "no camera": Bad(
        InvalidInput,
        "camera is missing",
        lambda: files({name: value for name, value in request_to_json(FULL).items() if name != "camera"}),
        lambda: without("camera"),
    ),
    "unknown proposer": Bad(
        InvalidInput, "proposer", lambda: files(changed("proposer", "best")), lambda: set_field("proposer", "best")
    ),
    "unknown planner": Bad(
        InvalidInput, "planner", lambda: files(changed("planner", "best")), lambda: set_field("planner", "best")
    ),
    "proposer that is not ready": Bad(
        Unavailable, "deep", lambda: files(changed("proposer", "deep")), lambda: set_field("proposer", "deep")
    ),
    "standoff that the sensor cannot see": Bad(
        InvalidInput, "standoff", lambda: files(changed("scan.standoff", 0.5)), lambda: set_field("scan.standoff", 0.5)
    ),
    "no tolerance": Bad(
        InvalidInput, "tolerance", lambda: files(changed("tolerance.error", 0)), lambda: set_field("tolerance.error", 0)
    ),
    "no budget": Bad(
        InvalidInput, "budget", lambda: files(changed("budget.scans", 0)), lambda: set_field("budget.scans", 0)
    ),
    "camera beyond the moon": Bad(
        InvalidInput,
        "base_T_camera",
        lambda: files(changed("base_T_camera.translation.0", 4e8)),
        lambda: set_field("base_t_camera.matrix.3", 4e8),
    ),
    "depth of light years": Bad(
        InvalidInput,
        "depth",
        lambda: files(depth=npy(np.full(MASK.shape, 1e20, np.float32))),
        lambda: with_depth(np.full(MASK.shape, 1e20, np.float32), "f4"),
    ),
    "five megapixels": Bad(
        TooLarge,
        "pixels",
        lambda: files(depth=png(image((2000, 2500), 7000, np.uint16))),
        lambda: message(depth=image((2000, 2500), 7000, np.uint16), mask=image((2000, 2500), 0)),
    ),
    "depth of float64": Bad(
        InvalidInput,
        "depth",
        lambda: files(depth=npy(np.ones(DEPTH.shape))),
        lambda: with_depth(np.ones(DEPTH.shape), "f8"),
    ),
    "depth of one dimension": Bad(
        InvalidInput,
        "shape",
        lambda: files(depth=npy(np.ones(400, np.float32))),
        lambda: with_depth(np.ones(400, np.float32), "f4"),
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_request_is_the_same_problem_on_both_wires(name: str, orchestrator: Orchestrator) -> None:
    bad = BAD[name]
    document, _ = over_rest(orchestrator, "POST", "/v1/sessions", files=bad.rest())
    check(document, bad.kind, bad.word)
    document, code = over_grpc(orchestrator, "CreateSession", bad.grpc())
    check(document, bad.kind, bad.word)
    assert code is code_of(bad.kind)


def test_a_proposer_that_is_not_ready_names_those_that_are(orchestrator: Orchestrator) -> None:
    bad = BAD["proposer that is not ready"]
    for document, _ in (
        over_rest(orchestrator, "POST", "/v1/sessions", files=bad.rest()),
        over_grpc(orchestrator, "CreateSession", bad.grpc()),
    ):
        assert all(name in document["detail"] + document["remedy"] for name in ("stability", "narf", "random"))


def number_paths(value: Any, path: str = "") -> Iterator[str]:
    """The dotted paths of all numbers in a JSON document."""
    if isinstance(value, dict | list):
        entries = value.items() if isinstance(value, dict) else enumerate(value)
        for name, member in entries:
            yield from number_paths(member, f"{path}.{name}" if path else str(name))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield path


@pytest.mark.parametrize("constant", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_no_number_of_a_request_may_be_anything_but_finite(constant: str, orchestrator: Orchestrator) -> None:
    with httpx.Client(base_url=orchestrator.rest_url, timeout=TIMEOUT, trust_env=False) as client:
        for path in number_paths(request_to_json(FULL)):
            body = json.dumps(changed(path, "@")).replace('"@"', constant).encode()
            form = files() | {"request": ("request.json", body, "application/json")}
            response = client.post("/v1/sessions", files=form)
            assert response.status_code == 400, path
            check(response.json(), Malformed)


@pytest.mark.parametrize("value", [1e300, -1e300, 5e-324])
def test_no_number_however_absurd_is_a_defect(value: float, orchestrator: Orchestrator) -> None:
    with httpx.Client(base_url=orchestrator.rest_url, timeout=TIMEOUT, trust_env=False) as client:
        for path in number_paths(request_to_json(FULL)):
            response = client.post("/v1/sessions", files=files(changed(path, value)))
            assert response.status_code in (201, 422), (path, response.text)


def float_paths(item: Message, path: str = "") -> Iterator[str]:
    """The dotted paths of all doubles in a message, arrays aside."""
    for field, value in item.ListFields():
        name = f"{path}.{field.name}" if path else field.name
        if field.name in ("depth", "mask"):
            continue
        repeated = isinstance(value, Message) is False and hasattr(value, "__len__") and not isinstance(value, str)
        for k, each in enumerate(value) if repeated else [(None, value)]:
            place = name if k is None else f"{name}.{k}"
            if isinstance(each, Message):
                yield from float_paths(each, place)
            elif isinstance(each, float):
                yield place


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_no_number_of_a_message_may_be_anything_but_finite(value: float, orchestrator: Orchestrator) -> None:
    paths = list(float_paths(request_to_proto(FULL, DEPTH, MASK)))
    assert len(paths) > 40
    for path in paths:
        document, _ = over_grpc(orchestrator, "CreateSession", set_field(path, value))
        check(document, Malformed)


def test_a_request_that_is_not_json_is_malformed(orchestrator: Orchestrator) -> None:
    for body in (b"", b"{", b"\xff\xfe", b"[" * 100_000, b'{"camera": {}} x'):
        form = files() | {"request": ("request.json", body, "application/json")}
        document, _ = over_rest(orchestrator, "POST", "/v1/sessions", files=form)
        check(document, Malformed, "JSON")


@pytest.mark.parametrize("name", ["request", "depth"])
def test_a_part_that_is_missing_is_named(name: str, orchestrator: Orchestrator) -> None:
    form = {key: value for key, value in files().items() if key != name}
    document, _ = over_rest(orchestrator, "POST", "/v1/sessions", files=form)
    check(document, InvalidInput, name)


def test_a_body_of_another_type_is_not_supported(orchestrator: Orchestrator) -> None:
    document, _ = over_rest(orchestrator, "POST", "/v1/sessions", json=request_to_json(FULL))
    check(document, UnsupportedMedia, "application/json")
    document, _ = over_rest(orchestrator, "POST", "/v1/sessions", content=b"x", headers={"content-type": "text/plain"})
    check(document, UnsupportedMedia, "text/plain")
    form = files() | {"depth": ("depth.jpg", png(DEPTH), "image/jpeg")}
    document, _ = over_rest(orchestrator, "POST", "/v1/sessions", files=form)
    check(document, UnsupportedMedia, "depth")


def test_a_form_that_cannot_be_taken_apart_is_malformed(orchestrator: Orchestrator) -> None:
    for content_type in ("multipart/form-data", "multipart/form-data; boundary=x"):
        document, _ = over_rest(
            orchestrator, "POST", "/v1/sessions", content=b"--y\r\n\r\nz", headers={"content-type": content_type}
        )
        assert document["status"] in (400, 422)
        check(document, Malformed if document["status"] == 400 else InvalidInput)


def test_a_wrong_token_is_the_same_problem_on_both_wires(guarded: Orchestrator) -> None:
    for header in (None, "Bearer wrong", f"Basic {TOKEN}", TOKEN):
        headers = {} if header is None else {"authorization": header}
        document, got = over_rest(guarded, "POST", "/v1/sessions", files=files(), headers=headers)
        check(document, Unauthenticated)
        assert got["www-authenticate"] == "Bearer"
        metadata = None if header is None else (("authorization", header),)
        document, code = over_grpc(guarded, "CreateSession", message(), metadata)
        check(document, Unauthenticated)
        assert code is code_of(Unauthenticated)


def test_what_was_refused_left_no_session(orchestrator: Orchestrator) -> None:
    with httpx.Client(base_url=orchestrator.rest_url, timeout=TIMEOUT, trust_env=False) as client:
        newest = client.get("/v1/sessions", params={"limit": 1}).json()["sessions"]
        for bad in BAD.values():
            client.post("/v1/sessions", files=bad.rest())
        assert client.get("/v1/sessions", params={"limit": 1}).json()["sessions"] == newest
