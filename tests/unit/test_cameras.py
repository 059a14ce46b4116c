"""Cameras that sessions name, through the session manager: what is learned, when it is doubted, and what is bounded."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.camera_ends import camera_record, converged
from helpers.loop_fakes import RandomDetector
from helpers.records import a_record
from helpers.scenes import Box, View, World
from pretouch_orchestrator.calibration.observation import difference
from pretouch_orchestrator.cameras import findings
from pretouch_orchestrator.cameras import manager as cameras_module
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_orchestrator.sessions.manager import SessionManager
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.sessions.upkeep import Limits, Upkeep
from pretouch_orchestrator.store import camera_sql, open_store
from pretouch_orchestrator.store.protocol import Event, Store
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar
from pretouch_simulation.in_process import InProcessRegistrar

from pretouch.estimate import Estimate, from_prior
from pretouch.geometry import Pose, rotation_from_vector
from pretouch.prior import Prior
from pretouch.serving import ServiceContext, Settings
from pretouch.session import Budget, Session, SessionRequest, Skipped, State, Submission
from pretouch.tof import Sensor

BELIEVED = a_record().request.base_T_camera
ERROR = Pose.from_rotation_vector((0.01, -0.02, 0.015), (0.008, -0.006, 0.01))
"""On the camera's side."""


class KnowingLoop:
    """Each session's only scan measures what `error`, on the camera's side, makes of the correction.

    It measures without noise what it states with 0.8 mm and 4 mrad, and gives the mean of that and of the prior, unless
    the two contradict each other.
    """

    def __init__(self) -> None:
        self.error = ERROR

    async def open(self, id: str, created: float, request: SessionRequest, *rest: Any) -> Record:
        record, (_, _, predict) = camera_record(id), rest
        if request.prior is None and predict is not None:
            request = replace(request, prior=predict(request.base_T_camera, record.scene.centroid))
        estimate = from_prior(request.prior or Prior(), record.scene.cloud)
        return replace(record, created=created, request=request, estimate=estimate)

    async def advance(self, record: Record, scan_id: str, submission: object) -> Record:
        believed = record.request.base_T_camera
        truth, centroid, prior = believed @ self.error @ believed.inverse(), record.scene.centroid, record.prior
        noise = np.diag([0.004**2] * 3 + [0.0008**2] * 3)
        known = prior.fallback.covariance if prior.is_contradicted_by(truth, centroid, noise) else prior.covariance
        gain = known @ np.linalg.inv(known + noise)
        change = gain @ difference(truth, prior.mean, centroid)
        turn, place = rotation_from_vector(change[:3]), prior.mean.apply(centroid)
        correction = Pose.of(turn, place - turn @ place + change[3:]) @ prior.mean
        covariance = known - gain @ known
        estimate = Estimate(correction, centroid, 0.5 * (covariance + covariance.T), 0.001, 0.002, samples=3)
        return replace(converged(record), estimate=estimate, answered=(scan_id,))


class Robot:
    """Runs sessions at an orchestrator of its own."""

    def __init__(self, store: Store, loop: Any) -> None:
        self.store, self.loop = store, loop
        self.context = ServiceContext("orchestrator", Settings())
        upkeep = Upkeep(store, Limits(3600.0, 2**30), self.context.log)
        self.sessions = SessionManager(store, loop, self.context, upkeep)

    async def create(self, camera: str | None = "head", **changes: Any) -> Session:
        request = replace(a_record().request, camera_id=camera, prior=None, **changes)
        return await self.sessions.create("", request, np.ones((4, 4), np.uint16), None, None)

    async def run(self, camera: str | None = "head", **changes: Any) -> Session:
        """The session as it was created; it has converged since."""
        session = await self.create(camera, **changes)
        assert session.next_scan is not None
        ended = await self.sessions.submit("", session.id, session.next_scan.scan_id, skipped)
        assert ended.state is State.CONVERGED
        return session

    async def told(self, session_id: str) -> Event:
        """The session's event of its camera."""
        (event,) = [each for each in await self.store.load_events(session_id, 0) if each.type == "camera"]
        return event

    def count(self, name: str, **labels: str) -> float:
        metric = f"pretouch_orchestrator_{name}_total"
        return self.context.metrics.registry.get_sample_value(metric, labels) or 0.0


async def skipped() -> Submission:
    return Skipped()


@pytest.fixture
async def robots(store_address: str) -> AsyncIterator[list[Robot]]:
    """Two orchestrators; those of SQLite share the store that is open, as two calls of one process do."""
    async with AsyncExitStack() as stack:
        stores: list[Store] = [await stack.enter_async_context(open_store(store_address))]
        if store_address.startswith("postgresql"):
            stores.append(await stack.enter_async_context(open_store(store_address)))
        made = [Robot(stores[0], KnowingLoop()), Robot(stores[-1], KnowingLoop())]
        for robot in made:
            stack.callback(robot.context.close)
            stack.push_async_callback(robot.sessions.close)
        yield made


@pytest.fixture
def robot(robots: list[Robot]) -> Robot:
    return robots[0]


def misplacement(session: Session, error: Pose = ERROR) -> float:
    """m: how far the session's estimate puts the object from where it is."""
    truth = BELIEVED @ error @ BELIEVED.inverse()
    centroid, estimate = session.estimate.centroid, session.estimate.base_T_correction
    return float(np.linalg.norm(truth.apply(centroid) - estimate.apply(centroid)))


async def test_sessions_start_from_what_earlier_ones_found(robot: Robot) -> None:
    sessions = [await robot.run() for _ in range(4)]
    default, learned = sessions[0].estimate.expected_error, sessions[3].estimate.expected_error
    assert learned < 0.4 * default
    assert misplacement(sessions[3]) < 0.1 * misplacement(sessions[0])
    assert (await robot.create(None)).estimate.expected_error == default
    assert (await robot.create("wrist")).estimate.expected_error == default
    assert robot.count("camera_sessions", state="converged", counts="yes") == 4


async def test_sessions_that_end_at_once_at_two_orchestrators_all_count_once(robots: list[Robot]) -> None:
    sessions = await asyncio.gather(*(robots[number % 2].run() for number in range(8)))
    camera = await robots[1].sessions.cameras.get("", "head")
    assert sorted(each.session for each in camera.history) == sorted(session.id for session in sessions)
    assert camera.sessions == 8
    assert {(await robots[0].told(session.id)).data["counts"] for session in sessions} == {True}
    (summary,) = await robots[0].sessions.cameras.list("")
    assert summary.residual == camera.residual, "the list says what follows from all of them"
    assert summary.camera_T_camera.is_close(camera.camera_T_camera, 1e-12)


async def test_a_knock_is_told_and_what_was_learned_is_not_used(robot: Robot) -> None:
    for _ in range(6):
        before = await robot.run()
    robot.loop.error = Pose.from_rotation_vector((0.0, 0.0, 0.0), (-0.02, 0.02, 0.0)) @ ERROR
    knocked = [await robot.run(), await robot.run()]
    told = [(await robot.told(session.id)).data for session in knocked]
    assert told[-1]["drift"] == {"state": "moved", "since": knocked[0].id}
    assert [warning["code"] for warning in told[-1]["warnings"]] == ["camera-moved"]
    assert robot.count("camera_alarms", state="moved") == 1
    after = await robot.create()
    (warning,) = [each for each in after.warnings if each.code == "camera-moved"]
    assert knocked[0].id in warning.detail
    assert warning.remedy
    assert misplacement(after, robot.loop.error) < 0.5 * misplacement(before, robot.loop.error)
    camera = await robot.sessions.cameras.get("", "head")
    assert camera.drift.state == "moved"
    assert len(camera.history) == 8
    assert len([each for each in camera.left_out if "moved" in each.reason]) == 6


async def test_one_confident_wrong_session_does_not_carry_the_camera_away(robot: Robot) -> None:
    for _ in range(5):
        await robot.run()
    robot.loop.error = Pose.of(np.eye(3), (0.03, -0.03, 0.0)) @ ERROR
    wrong = await robot.run()
    doubted = await robot.create()
    assert misplacement(doubted) < doubted.estimate.error_quantile, "no confident wrong prior"
    assert (await robot.told(wrong.id)).data["drift"] == {"state": "suspected", "since": wrong.id}
    assert (await robot.told(wrong.id)).data["warnings"] == []
    assert doubted.warnings == ()
    assert robot.count("camera_alarms", state="suspected") == 0
    robot.loop.error = ERROR
    for _ in range(3):
        await robot.run()
    camera = await robot.sessions.cameras.get("", "head")
    assert [each.session for each in camera.left_out] == [wrong.id]
    assert camera.drift.state == "steady"
    assert misplacement(await robot.create()) < 0.003


async def test_a_believed_pose_that_jumps_by_a_metre_gets_no_confident_prior(robot: Robot) -> None:
    first = await robot.run()
    for _ in range(4):
        await robot.run()
    moved = Pose.of(BELIEVED.rotation, BELIEVED.translation + np.array([0.0, 0.0, 1.0]))
    jumped = await robot.create(base_T_camera=moved)
    assert jumped.estimate.expected_error > 0.8 * first.estimate.expected_error


async def test_a_defect_of_the_estimator_stops_no_session(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    first = await robot.run()

    def fail(_: object) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    with monkeypatch.context() as broken:
        broken.setattr(findings, "estimate_calibration", fail)
        robot.sessions.cameras._calibrations.clear()
        second = await robot.run()
    assert second.estimate.expected_error == first.estimate.expected_error
    camera = await robot.sessions.cameras.get("", "head")
    assert [each.session for each in camera.history] == [first.id]
    assert [(each.session, each.reason) for each in camera.left_out] == [(second.id, "It could not be evaluated.")]
    assert not (await robot.told(second.id)).data["counts"]


async def test_beyond_the_cameras_that_are_remembered_sessions_go_on_with_a_warning(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (cameras_module, camera_sql):
        monkeypatch.setattr(module, "MAX_CAMERAS", 2)
    for name in ("one", "two"):
        assert (await robot.run(name)).warnings == ()
    assert [each.code for each in (await robot.run("three")).warnings] == ["cameras-full"]
    assert [each.id for each in await robot.sessions.cameras.list("")] == ["one", "two"]
    await robot.sessions.cameras.forget("", "two")
    assert (await robot.run("three")).warnings == ()


WORLD = World((Box.standing((0.09, 0.07, 0.05), (0.01, 0.0), 0.4),))


class FingerRobot(Robot):
    """Its camera is not where it believes; its finger scans the world as it is."""

    async def grasp(self) -> tuple[Session, Session]:
        """A session as it was created and as it ended."""
        view = View()
        depth, mask = WORLD.depth(replace(view, base_T_camera=view.base_T_camera @ ERROR), np.random.default_rng(7))
        request = SessionRequest(
            view.camera, view.base_T_camera, depth_scale=1.0, budget=Budget(4, 1000.0, 1.0), camera_id="head"
        )
        created = session = await self.sessions.create("", request, depth.metres, mask, None)
        while session.next_scan is not None:
            samples = WORLD.scanned(session.next_scan.path, Sensor(), np.random.default_rng(len(session.scans)))

            async def read(samples: Submission = samples) -> Submission:
                return samples

            session = await self.sessions.submit("", session.id, session.next_scan.scan_id, read)
        return created, session


async def test_with_the_real_registrar_a_second_session_starts_narrower_and_nearer(tmp_path: Any) -> None:
    async with open_store(f"sqlite:{tmp_path}") as store:
        robot = FingerRobot(store, Loop(RandomDetector(), InProcessRegistrar(Engine.POSTERIOR, Registrar())))
        first, ended = await robot.grasp()
        assert await robot.sessions.cameras.get("", "head")
        second, _ = await robot.grasp()
        await robot.sessions.close()
        robot.context.close()
    assert ended.state in (State.CONVERGED, State.EXHAUSTED)
    assert second.estimate.expected_error < 0.7 * first.estimate.expected_error
    view = View()
    truth = view.base_T_camera @ ERROR @ view.base_T_camera.inverse()
    c = first.estimate.centroid
    errors = [np.linalg.norm(truth.apply(c) - each.estimate.base_T_correction.apply(c)) for each in (first, second)]
    assert errors[1] < 0.5 * errors[0]
