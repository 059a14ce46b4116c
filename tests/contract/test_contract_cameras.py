"""The contract of cameras, over REST and gRPC: sessions that name one teach it, and the next session starts from it."""

from __future__ import annotations

import secrets
from typing import Any
from xml.etree import ElementTree

import grpc
import httpx
import numpy as np
import pytest
from helpers.box_session import DEPTH, MASK, ROOMY, VIEW, measured, request
from helpers.creation import changed, files, set_field
from helpers.processes import Orchestrator

from pretouch.calibrated_camera import CalibratedCamera
from pretouch.client import AsyncRestClient
from pretouch.errors import NotFound
from pretouch.prior import Prior
from pretouch.session import Budget, Session, State, Tolerance
from pretouch.v1 import orchestrator_pb2_grpc
from pretouch.wire.json import camera_to_json


@pytest.fixture
def name() -> str:
    """A camera that no other test knows."""
    return f"head.{secrets.token_hex(4)}"


def wanted(name: str | None, **changes: Any) -> Any:
    return request(budget=Budget(**ROOMY), camera_id=name, **changes)


async def converge(client: Any, name: str) -> tuple[Session, Session]:
    """A session when it is created and when it has converged."""
    created: Session = await client.create_session(wanted(name), DEPTH, MASK)
    session = created
    while session.next_scan is not None:
        session = await client.submit(session.id, session.next_scan.scan_id, measured(session.next_scan))
    assert session.state is State.CONVERGED
    return created, session


async def test_a_second_session_starts_from_what_the_first_found(client: Any, name: str) -> None:
    first, ended = await converge(client, name)
    second = await client.create_session(wanted(name), DEPTH, MASK)
    assert second.estimate.expected_error < 0.8 * first.estimate.expected_error
    moved, found = (each.estimate.base_T_correction.apply(each.estimate.centroid) for each in (second, ended))
    assert np.linalg.norm(moved - found) < 0.2 * np.linalg.norm(found - ended.estimate.centroid)
    for other in (wanted(None), wanted(name, prior=Prior())):
        unaffected = await client.create_session(other, DEPTH, MASK)
        assert unaffected.estimate.expected_error == first.estimate.expected_error

    camera: CalibratedCamera = await client.camera(name)
    assert (camera.id, camera.sessions, camera.drift.state, camera.drift.since) == (name, 1, "steady", None)
    (seen,) = camera.history
    assert (seen.session, camera.left_out) == (ended.id, ())
    assert 0.005 < seen.error < 0.02
    assert seen.expected_error == pytest.approx(first.estimate.expected_error, rel=1e-6)
    assert camera.base_T_camera_covariance is not None
    corrected = camera.base_T_base @ VIEW.base_T_camera @ camera.camera_T_camera
    assert camera.base_T_camera.is_close(corrected, 1e-9)
    (listed,) = [each for each in await client.cameras() if each.id == name]
    assert (listed.sessions, listed.drift) == (1, camera.drift)
    assert listed.camera_T_camera.is_close(camera.camera_T_camera, 1e-9)


async def test_a_camera_that_is_forgotten_is_not_known(client: Any, name: str) -> None:
    first, _ = await converge(client, name)
    await client.forget_camera(name)
    for call in (client.camera(name), client.forget_camera(name), client.camera("no.such"), client.forget_camera("-")):
        with pytest.raises(NotFound) as caught:
            await call
        assert caught.value.remedy
    assert name not in [each.id for each in await client.cameras()]
    assert (await client.session(first.id)).state is State.CONVERGED
    anew = await client.create_session(wanted(name), DEPTH, MASK)
    assert anew.estimate.expected_error == first.estimate.expected_error


async def test_sessions_that_do_not_count_say_why(client: Any, name: str) -> None:
    cancelled = await client.create_session(wanted(name), DEPTH, MASK)
    await client.cancel(cancelled.id)
    at_once = await client.create_session(wanted(name, tolerance=Tolerance(error=0.5)), DEPTH, MASK)
    assert at_once.state is State.CONVERGED
    camera = await client.camera(name)
    assert (camera.sessions, camera.history, camera.base_T_camera_covariance) == (0, (), None)
    reasons = {each.session: each.reason for each in camera.left_out}
    assert reasons == {cancelled.id: "It was cancelled.", at_once.id: "It made no scan."}
    assert camera.base_T_camera.is_close(VIEW.base_T_camera, 1e-9)


async def test_events_say_before_the_end_whether_a_session_counts(client: Any, name: str) -> None:
    _, ended = await converge(client, name)
    events = [event async for event in client.events(ended.id)]
    assert [event.type for event in events[-2:]] == ["camera", "end"]
    data = events[-2].data
    assert data == {"id": name, "counts": True, "drift": {"state": "steady", "since": None}, "warnings": []}


async def test_purging_a_session_keeps_what_its_camera_learned(client: Any, name: str) -> None:
    _, ended = await converge(client, name)
    await client.cancel(ended.id, purge=True)
    camera = await client.camera(name)
    assert [each.session for each in camera.history] == [ended.id]


async def test_every_client_is_told_the_same(client: Any, name: str, orchestrator: Orchestrator) -> None:
    await converge(client, name)
    told = camera_to_json(await client.camera(name))
    async with httpx.AsyncClient(base_url=orchestrator.rest_url) as rest:
        raw = (await rest.get(f"/v1/cameras/{name}")).json()
    assert set(raw) == set(told)
    np.testing.assert_allclose(raw.pop("covariance"), told.pop("covariance"), rtol=1e-9)
    for key in ("history", "left_out", "drift", "residual", "sessions", "id"):
        assert raw[key] == told[key]


async def test_a_sessions_report_shows_its_camera(orchestrator: Orchestrator, name: str) -> None:
    async with (
        AsyncRestClient(orchestrator.rest_url) as client,
        httpx.AsyncClient(base_url=orchestrator.rest_url) as rest,
    ):
        _, ended = await converge(client, name)

        async def report() -> tuple[dict[str, Any], str]:
            path = f"/v1/sessions/{ended.id}/report"
            document = (await rest.get(path, params={"format": "json"})).json()
            return document, (await rest.get(path)).text

        document, page = await report()
        told = camera_to_json(await client.camera(name))
        assert document["camera"] == {key: told[key] for key in ("id", "sessions", "drift", "history")}
        assert "Known from 1 session; no sign that it was moved." in page
        await client.forget_camera(name)
        document, page = await report()
        assert document["camera"] is None
        assert "session by session" not in page


async def test_rest_exports_the_pose_and_answers_head(orchestrator: Orchestrator, name: str) -> None:
    async with (
        AsyncRestClient(orchestrator.rest_url) as client,
        httpx.AsyncClient(base_url=orchestrator.rest_url) as rest,
    ):
        unknown = await rest.get(f"/v1/cameras/{name}/export")
        assert unknown.status_code == 404
        await client.create_session(wanted(name), DEPTH, MASK)
        nothing = await rest.get(f"/v1/cameras/{name}/export")
        assert (nothing.status_code, nothing.headers["content-type"]) == (409, "application/problem+json")
        assert nothing.json()["remedy"]
        await converge(client, name)
        exports = {
            format: await rest.get(f"/v1/cameras/{name}/export", params={"format": format})
            for format in ("json", "yaml", "urdf")
        }
        assert {each.status_code for each in exports.values()} == {200}
        assert exports["json"].json()["camera"] == name
        assert exports["yaml"].headers["content-type"].startswith("application/yaml")
        assert ElementTree.fromstring(f"<robot>{exports['urdf'].text}</robot>").find("joint/origin") is not None
        wrong = await rest.get(f"/v1/cameras/{name}/export", params={"format": "xacro"})
        assert (wrong.status_code, wrong.headers["content-type"]) == (422, "application/problem+json")
        for path in ("/v1/cameras", f"/v1/cameras/{name}", f"/v1/cameras/{name}/export"):
            head = await rest.head(path)
            assert (head.status_code, head.content) == (200, b"")
        assert (await rest.post(f"/v1/cameras/{name}")).status_code == 405
        deleted = await rest.delete(f"/v1/cameras/{name}")
        assert (deleted.status_code, deleted.content) == (204, b"")
        metrics = (await rest.get("/metrics")).text
        assert 'pretouch_orchestrator_camera_sessions_total{counts="yes",state="converged"}' in metrics


@pytest.mark.parametrize("bad", ["..", "a/b", "x" * 65, "a b", "ä", 7, None, ""])
async def test_what_is_no_name_of_a_camera_is_refused(orchestrator: Orchestrator, bad: object) -> None:
    async with httpx.AsyncClient(base_url=orchestrator.rest_url) as rest:
        answer = await rest.post("/v1/sessions", files=files(changed("camera.id", bad)))
    assert answer.status_code == 422
    assert "camera.id" in answer.json()["detail"]
    if not isinstance(bad, str) or not bad:
        return
    async with grpc.aio.insecure_channel(orchestrator.address) as channel:
        stub = orchestrator_pb2_grpc.OrchestratorServiceStub(channel)
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await stub.CreateSession(set_field("camera_id", bad))
    assert caught.value.code() is grpc.StatusCode.INVALID_ARGUMENT
