"""The REST contract of a real orchestrator process before fake upstream services."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import numpy as np
import pytest
from helpers import box_view
from helpers.fake_upstream import FakeUpstream
from helpers.processes import Orchestrator
from helpers.rest_sessions import assert_problem, opened, scan_path, scanned
from helpers.session_recordings import read_messages

from pretouch.geometry import Pose
from pretouch.tof import RangeSamples

LIMIT = 16 * 1024 * 1024


def test_a_session_runs_until_it_converges(rest: httpx.Client) -> None:
    response = rest.post("/v1/sessions", files=box_view.multipart(budget={"fraction": 1.0}))
    session = response.json()
    assert response.headers["location"] == f"/v1/sessions/{session['id']}"
    assert session["state"] == "awaiting_scan"
    assert session["proposer"] == "stability"
    assert rest.get(response.headers["location"]).json() == session
    errors = [session["estimate"]["expected_error"]]
    while session["state"] == "awaiting_scan":
        assert rest.get(f"/v1/sessions/{session['id']}/next-scan").json() == session["next_scan"]
        session = scanned(rest, session)
        errors.append(session["estimate"]["expected_error"])
    assert session["state"] == "converged"
    assert session["next_scan"] is None
    assert len(session["scans"]) == 3
    assert errors == sorted(errors, reverse=True)
    assert rest.get(f"/v1/sessions/{session['id']}").json() == session
    assert_problem(rest.get(f"/v1/sessions/{session['id']}/next-scan"), 409, "converged")


def test_the_same_scan_again_answers_the_present_session_whatever_the_body(rest: httpx.Client) -> None:
    session = opened(rest)
    first = scan_path(session)
    after = scanned(rest, session)
    for body in ({"json": {"samples": []}}, {"content": b"\xff", "headers": {"content-type": "image/png"}}, {}):
        again = rest.post(first, **body)  # type: ignore[arg-type]
        assert (again.status_code, again.json()) == (200, after)
    rest.delete(f"/v1/sessions/{session['id']}")
    again = rest.post(first, content=b"no JSON")
    assert (again.status_code, again.json()["state"]) == (200, "cancelled")


def test_a_scan_posted_twice_at_once_counts_once(rest: httpx.Client, fakes: FakeUpstream) -> None:
    session = opened(rest)
    registered = fakes.count("Register")
    with ThreadPoolExecutor(4) as pool:
        after = list(pool.map(lambda _: scanned(rest, session), range(4)))
    assert all(answer == after[0] for answer in after)
    assert len(after[0]["scans"]) == 1
    assert fakes.count("Register") == registered + 1


def test_a_skipped_scan_is_no_scan_and_another_region_is_planned(rest: httpx.Client) -> None:
    session = opened(rest)
    answer = rest.post(scan_path(session), json={"skipped": "unreachable"})
    assert answer.status_code == 200
    after = answer.json()
    assert after["scans"] == []
    assert after["next_scan"]["region_id"] != session["next_scan"]["region_id"]


def test_points_are_a_scan_too(rest: httpx.Client) -> None:
    session = opened(rest)
    after = rest.post(scan_path(session), json={"points": [[0.45, 0.0, 0.05], [0.46, 0.0, 0.05]]}).json()
    assert after["scans"][0]["returns"] == 2


def test_the_gateway_is_asked_for_its_span(rest: httpx.Client, fakes: FakeUpstream) -> None:
    session = opened(rest)
    span = {"gateway": {"device": "finger", "from": 100.0, "to": 102.5}}
    assert_problem(rest.post(scan_path(session), json=span), 422, "no samples")
    backwards = {"gateway": {"device": "finger", "from": 3.0, "to": 2.0}}
    assert_problem(rest.post(scan_path(session), json=backwards), 422, "gateway.to")
    assert_problem(rest.post(scan_path(session), json={"gateway": span["gateway"] | {"device": "toe"}}), 404, "toe")
    pose = Pose.of(np.diag([1.0, -1.0, -1.0]), [0.45, 0.0, 0.08]).matrix
    fakes.samples = RangeSamples(np.arange(4.0), np.tile(pose, (4, 1, 1)), np.full(4, 0.03), np.zeros(4), np.zeros(4))
    after = rest.post(scan_path(session), json=span)
    assert after.status_code == 200, after.text
    assert after.json()["scans"][0]["samples"] == 4
    asked = [call.request for call in fakes.calls if call.method == "GetSamples"][-1]
    assert (asked.device, getattr(asked, "from"), asked.to) == ("finger", 100.0, 102.5)


def test_unknown_sessions_and_scans_are_not_found(rest: httpx.Client) -> None:
    session = opened(rest)
    for method, path in (
        ("GET", ""),
        ("DELETE", ""),
        ("GET", "/next-scan"),
        ("GET", "/events"),
        ("POST", "/scans/s1"),
    ):
        assert_problem(rest.request(method, f"/v1/sessions/nobody{path}"), 404, "nobody")
    unknown = f"/v1/sessions/{session['id']}/scans/nothing"
    assert_problem(rest.post(unknown, json=box_view.samples(session["next_scan"])), 404, "nothing")


def test_an_ended_session_takes_no_scan(rest: httpx.Client) -> None:
    session = opened(rest)
    for _ in range(2):
        assert rest.delete(f"/v1/sessions/{session['id']}").status_code == 204
    assert_problem(rest.post(scan_path(session), json=box_view.samples(session["next_scan"])), 409, "cancelled")
    assert rest.get(f"/v1/sessions/{session['id']}").json()["state"] == "cancelled"


def test_a_converged_session_stays_converged_when_cancelled(rest: httpx.Client) -> None:
    session = opened(rest, tolerance={"error": 0.9})
    while session["state"] == "awaiting_scan":
        session = scanned(rest, session)
    assert session["state"] == "converged"
    assert rest.delete(f"/v1/sessions/{session['id']}").status_code == 204
    assert rest.get(f"/v1/sessions/{session['id']}").json() == session


def test_an_idempotency_key_makes_one_session(rest: httpx.Client, fakes: FakeUpstream) -> None:
    headers = {"Idempotency-Key": "6f1c2c1e"}

    def create(**changes: Any) -> httpx.Response:
        return rest.post("/v1/sessions", files=box_view.multipart(**changes), headers=headers)

    proposed = fakes.count("Propose")
    with ThreadPoolExecutor(3) as pool:
        answers = list(pool.map(lambda _: create(), range(3)))
    assert {answer.status_code for answer in answers} == {201}
    assert len({answer.json()["id"] for answer in answers}) == 1
    assert fakes.count("Propose") == proposed + 1
    assert_problem(create(scan={"speed": 0.04}), 409, "6f1c2c1e")
    assert_problem(rest.post("/v1/sessions", files=box_view.multipart(), headers={"Idempotency-Key": "k" * 300}), 422)


def test_a_key_whose_creation_failed_can_be_used_again(rest: httpx.Client) -> None:
    headers = {"Idempotency-Key": "second-try"}
    failed = rest.post("/v1/sessions", files=box_view.multipart(proposer="deep"), headers=headers)
    assert_problem(failed, 503, "stability, narf, random")
    assert rest.post("/v1/sessions", files=box_view.multipart(), headers=headers).status_code == 201


def test_pages_hold_every_session_once(rest: httpx.Client) -> None:
    mine = [opened(rest)["id"] for _ in range(3)]
    seen: list[str] = []
    cursor = ""
    while cursor is not None:
        page = rest.get("/v1/sessions", params={"limit": 2, "cursor": cursor}).json()
        assert len(page["sessions"]) <= 2
        seen += [session["id"] for session in page["sessions"]]
        cursor = page["next"]
    assert seen[:3] == mine[::-1]
    assert len(seen) == len(set(seen))
    for wrong in ({"limit": 0}, {"limit": 201}, {"limit": "x"}, {"cursor": "-1"}, {"cursor": "x"}):
        assert_problem(rest.get("/v1/sessions", params=wrong), 422)


@pytest.mark.parametrize(
    ("path", "value", "status", "word"),
    [
        (("camera", "fx"), -1, 422, "focal"),
        (("camera", "fx"), "525", 422, "camera.fx"),
        (("camera", "colour"), 1, 422, "camera.colour"),
        (("base_T_camera", "rotation"), [0, 0, 0, 2], 422, "norm"),
        (("roi",), [5, 5, 5, 9], 422, "roi"),
        (("proposer",), "best", 422, "deep"),
        (("budget",), {"scans": 0}, 422, "budget.scans"),
        (("table",), {"normal": [0, 0, 2], "offset": 0}, 422, "normal"),
        (("prior",), None, 422, "prior"),
        (("scan",), {"standoff": 0.5}, 422, "standoff"),
        (("nonsense",), 1, 422, "nonsense"),
    ],
)
def test_a_wrong_member_is_named(rest: httpx.Client, path: tuple[str, ...], value: Any, status: int, word: str) -> None:
    document = box_view.request()
    target = document
    for name in path[:-1]:
        target = target[name]
    target[path[-1]] = value
    files = box_view.multipart() | {"request": ("r", json.dumps(document).encode(), "application/json")}
    assert_problem(rest.post("/v1/sessions", files=files), status, word)


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999", "9" * 400, "9" * 5000])
def test_numbers_that_are_not_finite_are_malformed(rest: httpx.Client, number: str) -> None:
    document = json.dumps(box_view.request()).replace('"cx": 159.5', f'"cx": {number}')
    assert number in document
    files = box_view.multipart() | {"request": ("r", document.encode(), "application/json")}
    assert_problem(rest.post("/v1/sessions", files=files), 400)


@pytest.mark.parametrize("body", [b"", b"{", b"\xff\xfe", b"[" * 100_000, b'"\\ud800"', b"NaN"])
def test_a_scan_that_is_no_json_is_malformed(rest: httpx.Client, body: bytes) -> None:
    session = opened(rest)
    headers = {"content-type": "application/json"}
    assert_problem(rest.post(scan_path(session), content=body, headers=headers), 400)
    assert rest.get(f"/v1/sessions/{session['id']}").json() == session


@pytest.mark.parametrize(
    ("body", "status"),
    [
        ({}, 422),
        ([], 422),
        ({"samples": []}, 422),
        ({"points": [[1, 2]]}, 422),
        ({"points": [[1, 2, None]]}, 422),
        ({"skipped": "tired"}, 422),
        ({"gateway": {"device": 1, "from": 0, "to": 1}}, 422),
        ({"points": [[0, 0, 0]] * 20_001}, 413),
        ({"points": [[0, 0, 0]], "skipped": "unreachable"}, 422),
    ],
)
def test_a_wrong_scan_changes_nothing(rest: httpx.Client, body: Any, status: int) -> None:
    session = opened(rest)
    assert_problem(rest.post(scan_path(session), json=body), status)
    assert rest.get(f"/v1/sessions/{session['id']}").json() == session


def test_images_that_cannot_be_used_are_refused(rest: httpx.Client) -> None:
    def npy(array: np.ndarray[Any, Any]) -> bytes:
        stream = io.BytesIO()
        np.save(stream, array, allow_pickle=True)
        return stream.getvalue()

    good = box_view.multipart()
    _, mask = box_view.depth_and_mask()
    cases: list[tuple[str, bytes, int]] = [
        ("depth", b"", 400),
        ("depth", good["depth"][1][:700], 400),
        ("depth", box_view.png(mask), 422),
        ("depth", npy(np.array([{"a": 1}], dtype=object)), 422),
        ("depth", npy(np.zeros((100, 100))), 422),
        ("depth", npy(np.zeros((2001, 2000), np.uint16)), 413),
        ("depth", npy(np.zeros((240, 320), np.uint16)), 422),
        ("mask", b"GIF89a", 400),
        ("mask", box_view.png(np.zeros((240, 320, 3), np.uint8)), 422),
        ("mask", box_view.png(mask[:-1]), 422),
        ("mask", box_view.png(np.zeros_like(mask)), 422),
    ]
    count = len(rest.get("/v1/sessions", params={"limit": 200}).json()["sessions"])
    for part, data, status in cases:
        assert_problem(rest.post("/v1/sessions", files=good | {part: (part, data)}), status)
    assert len(rest.get("/v1/sessions", params={"limit": 200}).json()["sessions"]) == count


def test_npy_of_metres_and_no_mask_or_file_name_will_do(rest: httpx.Client) -> None:
    depth, _ = box_view.depth_and_mask()
    stream = io.BytesIO()
    np.save(stream, (depth * box_view.DEPTH_SCALE).astype(np.float32))
    document = box_view.request()
    document["camera"]["depth_scale"] = 1.0
    boundary = "a7f0c1"
    body = b"".join(
        f'--{boundary}\r\nContent-Disposition: form-data; name="{name}"\r\n\r\n'.encode() + data + b"\r\n"
        for name, data in (("request", json.dumps(document).encode()), ("depth", stream.getvalue()))
    )
    response = rest.post(
        "/v1/sessions",
        content=body + f"--{boundary}--\r\n".encode(),
        headers={"content-type": f"multipart/form-data; boundary={boundary}"},
    )
    assert response.status_code == 201, response.text


def test_forms_must_hold_each_part_once_and_as_what_it_is(rest: httpx.Client) -> None:
    good = box_view.multipart()
    assert_problem(rest.post("/v1/sessions", json=box_view.request()), 415, "multipart/form-data")
    jpeg = good | {"depth": ("depth", good["depth"][1], "image/jpeg")}
    assert_problem(rest.post("/v1/sessions", files=jpeg), 415, "image/jpeg")
    assert_problem(rest.post("/v1/sessions", files={"depth": good["depth"]}), 422, "request")
    assert_problem(rest.post("/v1/sessions", files=good | {"colour": ("c", b"")}), 422, "colour")
    assert_problem(rest.post("/v1/sessions", files=[*good.items(), ("depth", good["depth"])]), 422, "twice")
    headers = {"content-type": "multipart/form-data; boundary=b"}
    assert_problem(rest.post("/v1/sessions", content=b"rubbish", headers=headers), 400)
    headers = {"content-type": "multipart/form-data"}
    assert_problem(rest.post("/v1/sessions", content=b"", headers=headers), 400, "boundary")
    session = opened(rest)
    assert_problem(rest.post(scan_path(session), content=b"{}", headers={"content-type": "text/xml"}), 415, "text/xml")


def test_pages_that_do_not_exist_and_methods_that_do_not_fit_are_problems(rest: httpx.Client) -> None:
    assert_problem(rest.get("/nowhere"), 404, "/nowhere")
    assert_problem(rest.get("/v1/sessions/"), 404)
    answer = rest.put("/v1/sessions")
    assert_problem(answer, 405, "PUT")
    assert answer.headers["allow"] == "GET, HEAD, POST"


def test_a_body_beyond_the_limit_is_refused_unread(rest: httpx.Client, orchestrator: Orchestrator) -> None:
    session = opened(rest)

    part = b'--b\r\nContent-Disposition: form-data; name="depth"; filename="d"\r\n\r\n'

    def a_gigabyte() -> Iterator[bytes]:
        yield part
        for _ in range(1024):
            yield b" " * 2**20

    before = orchestrator.peak_memory()
    for path, kind in (("/v1/sessions", "multipart/form-data; boundary=b"), (scan_path(session), "application/json")):
        for length in ({}, {"content-length": str(len(part) + 2**30)}):
            response = rest.post(path, content=a_gigabyte(), headers={"content-type": kind} | length)
            assert_problem(response, 413, str(LIMIT))
    assert orchestrator.peak_memory() - before < 8 * LIMIT
    assert rest.get("/readyz").status_code == 200


def test_a_body_at_the_limit_is_read(rest: httpx.Client) -> None:
    session = opened(rest)
    body = json.dumps({"points": [[0.45, 0.0, 0.05]]}).encode()
    padded = body + b" " * (LIMIT - len(body))
    headers = {"content-type": "application/json"}
    assert rest.post(scan_path(session), content=padded, headers=headers).status_code == 200


def test_the_largest_scan_is_taken(rest: httpx.Client) -> None:
    session = opened(rest)
    pose = session["next_scan"]["waypoints"][0]["base_T_tip"]
    body = {"samples": [{"t": 0.001 * k, "base_T_tip": pose, "range": None} for k in range(20_000)]}
    after = rest.post(scan_path(session), json=body)
    assert after.status_code == 200
    assert after.json()["scans"][0]["samples"] == 20_000


def test_health_metrics_and_docs_are_served(rest: httpx.Client) -> None:
    assert rest.get("/healthz").json() == {"status": "ok"}
    assert rest.get("/readyz").json() == {"status": "ready"}
    opened(rest)
    assert "pretouch_orchestrator_sessions_created_total" in rest.get("/metrics").text
    page = rest.get("/docs").text
    assert "/v1/sessions/{session_id}/scans/{scan_id}" in page
    assert "src=" not in page
    paths = rest.get("/openapi.json").json()["paths"]
    assert set(paths["/v1/sessions"]) == {"get", "post"}


def test_a_report_is_there_at_any_moment_of_a_session(rest: httpx.Client) -> None:
    session = opened(rest)
    report = f"/v1/sessions/{session['id']}/report"
    assert "Under way without a scan" in rest.get(report).text
    session = scanned(rest, session)
    answer = rest.get(report)
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "Under way after 1 scan" in answer.text
    assert f"<td>{session['scans'][0]['path_id']}</td>" in answer.text
    head = rest.head(report)
    assert (head.status_code, head.content, head.headers["content-type"]) == (200, b"", "text/html; charset=utf-8")
    document = rest.get(report, params={"format": "json"}).json()
    assert [estimate["expected_error"] for estimate in document["estimates"]][1:] == [
        scan["expected_error"] for scan in session["scans"]
    ]
    rest.delete(f"/v1/sessions/{session['id']}")
    assert "Cancelled after 1 scan" in rest.get(report).text


def test_a_report_of_what_is_not_there_is_a_problem(rest: httpx.Client) -> None:
    assert_problem(rest.get("/v1/sessions/%3Cb%3E/report"), 404)
    session = opened(rest)
    assert_problem(rest.get(f"/v1/sessions/{session['id']}/report", params={"format": "pdf"}), 422, "format")


def test_a_recording_is_there_at_any_moment_of_a_session(rest: httpx.Client) -> None:
    session = opened(rest)
    path = f"/v1/sessions/{session['id']}/recording.mcap"
    assert "/pretouch/scans" not in read_messages(rest.get(path).content)
    session = scanned(rest, session)
    answer = rest.get(path)
    assert answer.headers["content-type"] == "application/octet-stream"
    assert answer.headers["content-disposition"] == f'attachment; filename="session-{session["id"]}.mcap"'
    found = read_messages(answer.content)
    (scan,) = found["/pretouch/scans"]
    assert scan.estimate.expected_error == session["scans"][0]["expected_error"]
    (told,) = found["/pretouch/session"]
    assert told.session.id == session["id"]
    head = rest.head(path)
    assert (head.status_code, head.content) == (200, b"")
    assert int(head.headers["content-length"]) == len(answer.content)
    rest.delete(f"/v1/sessions/{session['id']}")
    assert read_messages(rest.get(path).content)["/events"][-1].message == "cancelled"
    rest.delete(f"/v1/sessions/{session['id']}", params={"purge": "true"})
    assert_problem(rest.get(path), 404)


def test_a_recording_of_what_is_not_there_is_a_problem(rest: httpx.Client) -> None:
    assert_problem(rest.get("/v1/sessions/%3Cb%3E/recording.mcap"), 404)
    assert_problem(rest.post("/v1/sessions/x/recording.mcap"), 405)
