"""Whatever a client sends to open a session, it learns what was wrong and what to do, the same over REST and gRPC."""

from __future__ import annotations

import copy
import dataclasses
import io
import json
import pickle
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from box_session import DEPTH, MASK, TOKEN, request
from box_view import png
from google.protobuf.message import Message
from problems import TIMEOUT, check, code_of, over_grpc, over_rest
from processes import Orchestrator

from pretouch.client import GrpcClient, RestClient
from pretouch.errors import (
    InvalidInput,
    Malformed,
    PretouchError,
    TooLarge,
    Unauthenticated,
    Unavailable,
    UnsupportedMedia,
)
from pretouch.geometry import Plane, Pose
from pretouch.v1 import orchestrator_pb2 as pb
from pretouch.wire.common import array_to_proto
from pretouch.wire.json import request_to_json
from pretouch.wire.session import request_to_proto

FULL = request(
    roi=(0, 0, 320, 240),
    table=Plane(np.array([0.0, 0.0, 1.0]), 0.0),
    base_T_object=Pose.identity(),
)
"""A request with every member."""


def files(document: Any = None, depth: bytes | None = None, mask: bytes | None = None) -> dict[str, Any]:
    """The multipart form, good but for what is given."""
    body = json.dumps(request_to_json(request()) if document is None else document).encode()
    return {
        "request": ("request.json", body, "application/json"),
        "depth": ("depth.png", png(DEPTH) if depth is None else depth, "application/octet-stream"),
        "mask": ("mask.png", png(np.where(MASK, 255, 0).astype(np.uint8)) if mask is None else mask, "image/png"),
    }


def message(depth: np.ndarray = DEPTH, mask: np.ndarray = MASK) -> pb.CreateSessionRequest:
    return request_to_proto(request(), depth, mask)


def changed(path: str, value: Any, document: Any = None) -> Any:
    """The request's JSON with the member at the dotted `path` set to `value`."""
    result = copy.deepcopy(request_to_json(FULL) if document is None else document)
    *parents, last = [int(step) if step.isdigit() else step for step in path.split(".")]
    owner = result
    for step in parents:
        owner = owner[step]
    owner[last] = value
    return result


def set_field(path: str, value: Any) -> pb.CreateSessionRequest:
    """The request's message with the field at the dotted `path` set to `value`."""
    result: Message = request_to_proto(FULL, DEPTH, MASK)
    *parents, last = path.split(".")
    owner: Any = result
    for step in parents:
        owner = owner[int(step)] if step.isdigit() else getattr(owner, step)
    if last.isdigit():
        owner[int(last)] = value
    else:
        setattr(owner, last, value)
    return result  # type: ignore[return-value]


def image(shape: tuple[int, int], value: int, dtype: type = np.uint8) -> np.ndarray:
    return np.full(shape, value, dtype)


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
        "mask",
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
        lambda: _roi(0, 0, 20, 20),
    ),
    "roi inside out": Bad(
        InvalidInput, "roi", lambda: files(changed("roi", [20, 0, 10, 20])), lambda: _roi(20, 0, 10, 20)
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
        lambda: _without("camera"),
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
        lambda: _depth(np.full(MASK.shape, 1e20, np.float32), "f4"),
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
        lambda: _depth(np.ones(DEPTH.shape), "f8"),
    ),
    "depth of one dimension": Bad(
        InvalidInput,
        "shape",
        lambda: files(depth=npy(np.ones(400, np.float32))),
        lambda: _depth(np.ones(400, np.float32), "f4"),
    ),
}


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    return stream.getvalue()


def _roi(u0: int, v0: int, u1: int, v1: int) -> pb.CreateSessionRequest:
    result = message()
    result.roi.CopyFrom(pb.Roi(u0=u0, v0=v0, u1=u1, v1=v1))
    return result


def _without(name: str) -> pb.CreateSessionRequest:
    result = message()
    result.ClearField(name)  # type: ignore[arg-type]
    return result


def _depth(array: np.ndarray, dtype: str) -> pb.CreateSessionRequest:
    result = message()
    result.depth.CopyFrom(array_to_proto(array, dtype))
    return result


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
    elif isinstance(value, int | float):
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


def test_a_png_that_is_none_is_malformed(orchestrator: Orchestrator) -> None:
    whole = png(DEPTH)
    for depth in (b"", b"depth", whole[:1000], whole[:40] + bytes(1000) + whole[1040:], b"GIF89a" + bytes(100)):
        document, _ = over_rest(orchestrator, "POST", "/v1/sessions", files=files(depth=depth))
        check(document, Malformed, "PNG")
    document, _ = over_rest(orchestrator, "POST", "/v1/sessions", files=files(mask=whole[:100]))
    check(document, Malformed, "mask")


def test_a_png_of_another_kind_is_not_valid(orchestrator: Orchestrator) -> None:
    for depth in (png(image(DEPTH.shape, 200)), png(np.dstack([MASK.astype(np.uint8)] * 3))):
        document, _ = over_rest(orchestrator, "POST", "/v1/sessions", files=files(depth=depth))
        check(document, InvalidInput, "16-bit")


def test_an_array_that_does_not_fill_its_shape_is_not_valid(orchestrator: Orchestrator) -> None:
    short = message()
    short.depth.data = short.depth.data[:-2]
    document, _ = over_grpc(orchestrator, "CreateSession", short)
    check(document, InvalidInput, "depth")
    huge = message()
    del huge.depth.shape[:]
    huge.depth.shape.extend([2**32 - 1, 2**32 - 1])
    document, _ = over_grpc(orchestrator, "CreateSession", huge)
    check(document, InvalidInput, "depth")


class Trap:
    """Makes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __reduce__(self) -> Any:
        return (open, (str(self._path), "w"))


def test_a_pickle_is_refused_and_not_opened(orchestrator: Orchestrator, tmp_path: Path) -> None:
    sprung = tmp_path / "sprung"
    trap = np.empty((2, 2), dtype=object)
    trap[:] = [[Trap(sprung)] * 2] * 2
    for depth in (npy(trap), pickle.dumps(Trap(sprung)), npy(np.array(Trap(sprung)))):
        document, _ = over_rest(orchestrator, "POST", "/v1/sessions", files=files(depth=depth))
        check(document, Malformed if document["status"] == 400 else InvalidInput)
    assert not sprung.exists()


def test_an_array_file_that_is_damaged_is_malformed(orchestrator: Orchestrator) -> None:
    whole = npy(DEPTH)
    for depth in (whole[:20], whole[:-5], whole.replace(b"'shape'", b"'shapf'"), whole[:6] + b"\x09" + whole[7:]):
        document, _ = over_rest(orchestrator, "POST", "/v1/sessions", files=files(depth=depth))
        check(document, Malformed, "npy")
    bomb = whole.replace(b"(240, 320)", b"(2400000, 3200000)".ljust(10))
    document, _ = over_rest(orchestrator, "POST", "/v1/sessions", files=files(depth=bomb))
    assert document["status"] in (400, 413)


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


def test_a_gigabyte_is_refused_before_it_is_read(orchestrator: Orchestrator) -> None:
    with RestClient(orchestrator.rest_url) as client:
        session = client.create_session(request(), DEPTH, MASK)
    assert session.next_scan is not None
    scan_path = f"/v1/sessions/{session.id}/scans/{session.next_scan.scan_id}"
    form = b'--x\r\nContent-Disposition: form-data; name="depth"; filename="depth.png"\r\n\r\n'
    before = orchestrator.peak_memory()
    for path, media_type, start in (
        ("/v1/sessions", "multipart/form-data; boundary=x", form),
        (scan_path, "application/json", b'{"samples": ['),
    ):
        for announced in ({}, {"content-length": str(len(start) + (1 << 30))}):
            taken: list[int] = []
            headers = {"content-type": media_type} | announced
            document, _ = over_rest(orchestrator, "POST", path, content=gigabyte(start, taken), headers=headers)
            check(document, TooLarge, "bytes")
            assert sum(taken) < 128 << 20
    assert orchestrator.peak_memory() - before < 100 << 20


def gigabyte(start: bytes, taken: list[int]) -> Iterator[bytes]:
    """`start` and a gigabyte; `taken` holds the sizes of the pieces that were asked for."""
    yield start
    for _ in range(1024):
        taken.append(1 << 20)
        yield bytes(1 << 20)


def test_a_message_beyond_the_limit_is_refused(orchestrator: Orchestrator) -> None:
    big = np.ones((4000, 4200), np.float32)
    with GrpcClient(orchestrator.address) as client, pytest.raises(TooLarge):
        client.create_session(request(), big, np.ones(big.shape))


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
