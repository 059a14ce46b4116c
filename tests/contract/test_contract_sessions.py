"""The contract of sessions, over REST and gRPC: they converge, exhaust, are cancelled, and repeat their answers."""

import asyncio
from typing import Any

import httpx
import numpy as np
import pytest
from helpers.box_session import DEPTH, DEPTH_SCALE, MASK, ROOMY, TOKEN, measured, request
from helpers.client_kinds import KINDS, opened
from helpers.fake_upstream import DEVICE, FakeUpstream
from helpers.processes import Orchestrator

from pretouch.client import GrpcClient, RestClient, drive, drive_async
from pretouch.errors import Conflict, InvalidInput, NotFound, Unauthenticated
from pretouch.estimate import point_error
from pretouch.geometry import Pose
from pretouch.prior import PosePrior, Prior
from pretouch.session import (
    Budget,
    GatewaySpan,
    Planner,
    Points,
    Proposer,
    SampleChunk,
    ScanPlan,
    Session,
    Skipped,
    State,
    Submission,
    Tolerance,
)
from pretouch.tof import RangeSamples
from pretouch.wire.json import session_to_json

roomy = request(budget=Budget(**ROOMY))


async def test_a_session_converges(client: Any) -> None:
    base_T_object = Pose.from_rotation_vector([0.1, 0.2, 0.3], [0.01, 0.02, 0.03])
    wanted = request(budget=Budget(**ROOMY), base_T_object=base_T_object, proposer=Proposer.NARF)
    session: Session = await client.create_session(wanted, DEPTH, MASK)
    assert session.state is State.AWAITING_SCAN
    assert (session.proposer, session.planner) == (Proposer.NARF, Planner.INFORMATION)
    assert session.estimate.base_T_correction.is_close(Pose.identity())
    assert session.base_T_object is not None
    assert session.base_T_object.is_close(base_T_object)
    assert len(session.regions) == 3
    assert session.next_scan is not None
    assert session.next_scan.region_id in {region.id for region in session.regions}
    errors = [session.estimate.expected_error]
    while session.next_scan is not None:
        plan = await client.next_scan(session.id)
        assert plan.scan_id == session.next_scan.scan_id
        session = await client.submit(session.id, plan.scan_id, measured(plan))
        errors.append(session.estimate.expected_error)
    assert session.state is State.CONVERGED
    assert session.reason is None
    assert session.estimate.error_quantile <= 0.003
    assert errors == sorted(errors, reverse=True)
    assert len(session.scans) == session.budget_used.scans == len(errors) - 1 == 3
    assert session.budget_used.seconds == pytest.approx(sum(scan.duration for scan in session.scans))
    assert [scan.expected_error for scan in session.scans] == errors[1:]
    assert 0 < session.budget_used.fraction <= 1
    assert session.base_T_object.is_close(session.estimate.base_T_correction @ base_T_object, 1e-6)
    assert session_to_json(await client.session(session.id)) == session_to_json(session)
    with pytest.raises(Conflict) as caught:
        await client.next_scan(session.id)
    assert caught.value.remedy


async def test_a_session_starts_from_the_mean_and_covariance_of_its_prior(client: Any) -> None:
    stds = np.array([0.01, 0.02, 0.03, 0.003, 0.004, 0.005])
    prior = PosePrior(Pose.from_rotation_vector([0.0, 0.02, 0.1], [0.01, 0.02, 0.003]), np.diag(stds**2))
    session = await client.create_session(request(prior=prior, budget=Budget(**ROOMY)), DEPTH, MASK)
    assert session.estimate.base_T_correction.is_close(prior.mean, 1e-9)
    np.testing.assert_allclose(session.estimate.covariance, prior.covariance, rtol=1e-12, atol=0)
    after = await client.submit(session.id, session.next_scan.scan_id, measured(session.next_scan))
    shrunk = after.estimate.covariance / np.diag(stds**2).clip(1e-30)
    assert np.diag(shrunk).max() < 0.2


@pytest.mark.parametrize(
    ("shift", "turn", "words"), [(0.6, 0.0, r"moves the object by 0\.6 m"), (0.0, 0.9, r"turns by 51\.6 deg")]
)
async def test_a_prior_of_something_else_is_refused(client: Any, shift: float, turn: float, words: str) -> None:
    prior = PosePrior(Pose.identity(), 1e-4 * np.eye(6))
    mean = Pose.from_rotation_vector([0, 0, turn], [shift, 0, 0])
    object.__setattr__(prior, "base_T_correction", mean)
    with pytest.raises(InvalidInput, match=words) as caught:
        await client.create_session(request(prior=prior), DEPTH, MASK)
    assert caught.value.remedy


async def test_the_object_may_be_found_without_a_mask(client: Any) -> None:
    metres = (DEPTH * DEPTH_SCALE).astype(np.float32)
    metres[0, 0] = np.nan
    wanted = request()
    session = await client.create_session(
        type(wanted)(camera=wanted.camera, base_T_camera=wanted.base_T_camera, depth_scale=1.0), metres
    )
    assert session.state is State.AWAITING_SCAN
    with_mask = await client.create_session(wanted, DEPTH, MASK)
    np.testing.assert_allclose(session.estimate.centroid, with_mask.estimate.centroid, atol=2e-3)


async def test_a_session_that_may_scan_once_is_exhausted_after_it(client: Any) -> None:
    budget = Budget(scans=1, seconds=1e5, fraction=1.0)
    session = await client.create_session(request(budget=budget), DEPTH, MASK)
    session = await client.submit(session.id, session.next_scan.scan_id, measured(session.next_scan))
    assert session.state is State.EXHAUSTED
    assert session.next_scan is None


async def test_a_tolerance_that_the_prior_meets_needs_no_scan(client: Any) -> None:
    session = await client.create_session(request(tolerance=Tolerance(error=0.5)), DEPTH, MASK)
    assert session.state is State.CONVERGED
    assert session.next_scan is None


async def test_a_cancelled_session_stays_cancelled(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    await client.cancel(session.id)
    await client.cancel(session.id)
    after = await client.session(session.id)
    assert (after.state, after.next_scan) == (State.CANCELLED, None)
    with pytest.raises(Conflict, match="cancelled"):
        await client.submit(session.id, session.next_scan.scan_id, measured(session.next_scan))


async def test_the_error_counts_at_the_points_of_the_tolerance(client: Any) -> None:
    prior, budget = Prior(0.001, 0.1), Budget(**ROOMY)
    whole = await client.create_session(request(budget=budget, prior=prior), DEPTH, MASK)
    middle = whole.estimate.centroid[None]
    tolerance = Tolerance(error=0.0005, at=middle)
    session = await client.create_session(request(budget=budget, prior=prior, tolerance=tolerance), DEPTH, MASK)
    assert session.estimate.expected_error < 0.6 * whole.estimate.expected_error
    assert max(region.expected_error for region in session.regions) < session.estimate.expected_error
    plan = session.next_scan
    progress = await client.tell(session.id, plan.scan_id, SampleChunk(0, measured(plan)))
    assert progress.error_quantile <= session.estimate.error_quantile
    after = await client.submit(session.id, plan.scan_id, RangeSamples.concatenate([]))
    covariance, centroid = after.estimate.covariance, after.estimate.centroid
    assert after.estimate.expected_error == pytest.approx(point_error(covariance, middle, centroid)[0])


async def test_a_session_that_awaits_a_scan_has_a_forecast(client: Any) -> None:
    budget = Budget(scans=4, seconds=60.0, fraction=1.0)
    session = await client.create_session(request(budget=budget), DEPTH, MASK)
    while session.next_scan is not None:
        forecast = session.forecast
        assert 1 <= forecast.scans <= budget.scans - session.budget_used.scans
        assert 0 < forecast.seconds <= budget.seconds - session.budget_used.seconds
        assert 0 <= forecast.chance <= 1
        assert (await client.session(session.id)).forecast == forecast
        session = await client.submit(session.id, session.next_scan.scan_id, measured(session.next_scan))
    assert session.forecast is None
    cancelled = await client.create_session(request(budget=budget), DEPTH, MASK)
    await client.cancel(cancelled.id)
    assert (await client.session(cancelled.id)).forecast is None


async def test_cancelling_leaves_an_ended_session_as_it_ended(client: Any) -> None:
    session = await client.create_session(request(tolerance=Tolerance(error=0.5)), DEPTH, MASK)
    await client.cancel(session.id)
    assert (await client.session(session.id)).state is State.CONVERGED


async def test_a_purged_session_is_gone_whatever_its_state(client: Any) -> None:
    for tolerance in (Tolerance(), Tolerance(error=0.5)):
        session = await client.create_session(request(tolerance=tolerance), DEPTH, MASK)
        await client.cancel(session.id, purge=True)
        for call in (client.session(session.id), client.cancel(session.id), client.cancel(session.id, purge=True)):
            with pytest.raises(NotFound, match=session.id):
                await call


async def test_a_cancellation_does_not_wait_for_the_step_under_way(client: Any, fakes: FakeUpstream) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    with fakes.held("Register"):
        step = asyncio.create_task(client.submit(session.id, plan.scan_id, measured(plan)))
        await asyncio.to_thread(fakes.wait_for_call, "Register")
        await client.cancel(session.id)
        with pytest.raises(Conflict, match="cancelled"):
            await step
    assert (await client.session(session.id)).state is State.CANCELLED


async def test_the_same_scan_again_changes_nothing(client: Any) -> None:
    first = await client.create_session(request(budget=Budget(scans=2, seconds=1e5, fraction=1.0)), DEPTH, MASK)
    samples = measured(first.next_scan)
    second = await client.submit(first.id, first.next_scan.scan_id, samples)
    again = await client.submit(first.id, first.next_scan.scan_id, samples)
    assert session_to_json(again) == session_to_json(second)
    other = await client.submit(first.id, first.next_scan.scan_id, Skipped())
    assert session_to_json(other) == session_to_json(second)
    third = await client.submit(first.id, second.next_scan.scan_id, measured(second.next_scan))
    assert third.state is State.EXHAUSTED
    after_the_end = await client.submit(first.id, first.next_scan.scan_id, samples)
    assert session_to_json(after_the_end) == session_to_json(third)


async def test_two_answers_at_once_count_once(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    answers = await asyncio.gather(*(client.submit(session.id, plan.scan_id, measured(plan)) for _ in range(4)))
    assert [answer.budget_used.scans for answer in answers] == [1, 1, 1, 1]


async def test_unknown_sessions_and_scans_are_not_found(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    samples = measured(session.next_scan)
    unknown = [
        lambda: client.session("no-such-session"),
        lambda: client.next_scan("no-such-session"),
        lambda: client.cancel("no-such-session"),
        lambda: client.submit("no-such-session", "scan-1", samples),
        lambda: client.submit(session.id, "no-such-scan", samples),
    ]
    for call in unknown:
        with pytest.raises(NotFound, match="no-such") as caught:
            await call()
        assert caught.value.remedy
    with pytest.raises(NotFound, match="no-such"):
        [event async for event in client.events("no-such-session")]
    assert (await client.session(session.id)).budget_used.scans == 0


async def test_a_skipped_scan_changes_no_estimate_and_costs_nothing(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    after = await client.submit(session.id, plan.scan_id, Skipped(measured(plan)))
    assert after.state is State.AWAITING_SCAN
    assert after.scans == ()
    assert after.budget_used.scans == 0
    assert after.estimate.expected_error == session.estimate.expected_error
    assert after.next_scan.path_id != plan.path_id
    skipped = {plan.path_id}
    while after.next_scan is not None:
        assert after.next_scan.path_id not in skipped
        skipped.add(after.next_scan.path_id)
        after = await client.submit(session.id, after.next_scan.scan_id, Skipped())
    assert (after.state, after.next_scan) == (State.EXHAUSTED, None)


async def test_a_gateway_span_stands_for_the_samples_it_names(client: Any, fakes: FakeUpstream) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    fakes.samples = measured(plan)
    after = await client.submit(session.id, plan.scan_id, GatewaySpan(DEVICE, 100.0, 200.0))
    assert after.scans[0].samples == len(fakes.samples)
    assert after.scans[0].returns == int(np.isfinite(fakes.samples.range).sum())
    asked = [call.request for call in fakes.calls if call.method == "GetSamples"][-1]
    assert (asked.device, getattr(asked, "from"), asked.to) == (DEVICE, 100.0, 200.0)
    with pytest.raises(NotFound, match="thumb"):
        await client.submit(session.id, after.next_scan.scan_id, GatewaySpan("thumb", 100.0, 200.0))
    assert (await client.session(session.id)).budget_used.scans == 1


async def test_points_are_a_scan_too(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    samples = measured(session.next_scan)
    hit = np.isfinite(samples.range)
    points = samples.base_T_tip[hit, :3, 3] + samples.range[hit, None] * samples.base_T_tip[hit, :3, 2]
    after = await client.submit(session.id, session.next_scan.scan_id, Points(points))
    assert (after.scans[0].samples, after.scans[0].returns) == (len(points), len(points))


async def test_a_scan_without_a_return_counts_as_a_scan(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    samples = measured(session.next_scan)
    missed = type(samples)(samples.t, samples.base_T_tip, np.full(len(samples), np.nan), samples.status, samples.module)
    after = await client.submit(session.id, session.next_scan.scan_id, missed)
    assert (after.scans[0].samples, after.scans[0].returns) == (len(samples), 0)


async def test_one_key_opens_one_session(client: Any) -> None:
    key = f"key of {client!r}"
    first = await client.create_session(roomy, DEPTH, MASK, key)
    again = await client.create_session(roomy, DEPTH, MASK, key)
    assert again.id == first.id
    with pytest.raises(Conflict, match="key"):
        await client.create_session(request(planner=Planner.CONFIDENCE), DEPTH, MASK, key)
    assert (await client.create_session(roomy, DEPTH, MASK)).id != first.id


async def test_sessions_are_listed_in_pages(client: Any) -> None:
    made = [(await client.create_session(roomy, DEPTH, MASK)).id for _ in range(3)]
    page = await client.sessions(limit=2)
    assert [session.id for session in page.sessions] == made[:0:-1]
    following = await client.sessions(2, page.next)
    assert following.sessions[0].id == made[0]
    listed = [session.id async for session in client.all_sessions()]
    assert listed[:3] == made[::-1]
    assert len(listed) == len(set(listed))


@pytest.mark.parametrize("limit", [0, -1, 201, 2**31, 2**70])
async def test_a_limit_that_is_none_is_refused(limit: int, client: Any) -> None:
    with pytest.raises(InvalidInput):
        await client.sessions(limit)


@pytest.mark.parametrize("cursor", ["x", "-1", "²", "9" * 19, "\0", "1 "])
async def test_a_cursor_that_is_none_is_refused(cursor: str, client: Any) -> None:
    with pytest.raises(InvalidInput):
        await client.sessions(5, cursor)


async def test_a_hundred_event_streams_leave_room_for_a_call(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    streams = [client.events(session.id) for _ in range(120)]
    heard = [await anext(stream) for stream in streams]
    assert {event.type for event in heard} == {"session"}
    assert (await client.session(session.id)).id == session.id
    for stream in streams:
        await stream.aclose()


async def test_events_tell_the_session_from_its_start_and_resume(client: Any) -> None:
    session = await client.create_session(request(budget=Budget(scans=1, seconds=1e5, fraction=1.0)), DEPTH, MASK)
    await client.submit(session.id, session.next_scan.scan_id, measured(session.next_scan))
    events = [event async for event in client.events(session.id)]
    assert events[0].type == "session"
    assert events[-1].type == "end"
    assert {"scan", "estimate"} <= {event.type for event in events}
    ids = [event.id for event in events]
    assert ids == sorted(set(ids))
    later = [event async for event in client.events(session.id, after=ids[1])]
    assert later == events[2:]
    assert [event async for event in client.events(session.id, after=ids[-1])] == []


async def test_a_listener_hears_the_session_go_on(client: Any) -> None:
    session = await client.create_session(request(budget=Budget(scans=1, seconds=1e5, fraction=1.0)), DEPTH, MASK)
    listening = asyncio.create_task(collected(client, session.id))
    await client.submit(session.id, session.next_scan.scan_id, measured(session.next_scan))
    assert (await listening)[-1] == "end"


async def collected(client: Any, session_id: str) -> list[str]:
    return [event.type async for event in client.events(session_id)]


async def test_a_failing_service_leaves_the_session_as_it_was(client: Any, fakes: FakeUpstream) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    fakes.fail("Register", InvalidInput("a scan of nonsense", "mend it"))
    with pytest.raises(InvalidInput, match="nonsense"):
        await client.submit(session.id, plan.scan_id, measured(plan))
    after = await client.session(session.id)
    assert session_to_json(after) == session_to_json(session)
    assert (await client.submit(session.id, plan.scan_id, measured(plan))).budget_used.scans == 1


@pytest.mark.parametrize("kind", KINDS)
async def test_a_token_is_wanted_where_one_is_set(kind: str, guarded: Orchestrator) -> None:
    async with opened(kind, guarded.rest_url, guarded.address, token=TOKEN) as friend:
        session = await friend.create_session(roomy, DEPTH, MASK)
        await friend.submit(session.id, session.next_scan.scan_id, Skipped())
        await friend.cancel(session.id)
        assert await collected(friend, session.id)
    for token in (None, "wrong-horse"):
        async with opened(kind, guarded.rest_url, guarded.address, token=token) as stranger:
            for call in (
                stranger.session(session.id),
                stranger.sessions(),
                stranger.cancel(session.id),
                stranger.create_session(roomy, DEPTH, MASK),
                collected(stranger, session.id),
            ):
                with pytest.raises(Unauthenticated) as caught:
                    await call
                assert caught.value.remedy


@pytest.mark.parametrize("kind", ["rest", "grpc"])
def test_drive_scans_until_the_session_ends(kind: str, orchestrator: Orchestrator) -> None:
    one = RestClient(orchestrator.rest_url) if kind == "rest" else GrpcClient(orchestrator.address)
    with one as client:
        session = client.create_session(roomy, DEPTH, MASK)
        states = [each.state for each in drive(client, session, measured)]
    assert states == [State.AWAITING_SCAN] * 3 + [State.CONVERGED]


@pytest.mark.parametrize("kind", ["rest-async", "grpc-async"])
async def test_drive_async_scans_until_the_session_ends(kind: str, orchestrator: Orchestrator) -> None:
    async def execute(plan: ScanPlan) -> Submission:
        return measured(plan)

    async with opened(kind, orchestrator.rest_url, orchestrator.address) as client:
        session = await client.create_session(roomy, DEPTH, MASK)
        states = [each.state async for each in drive_async(client, session, execute)]
    assert states == [State.AWAITING_SCAN] * 3 + [State.CONVERGED]


async def test_both_wires_show_the_same_session(orchestrator: Orchestrator) -> None:
    with RestClient(orchestrator.rest_url) as rest, GrpcClient(orchestrator.address) as grpc:
        session = rest.create_session(roomy, DEPTH, MASK)
        session = grpc.submit(session.id, session.next_scan.scan_id, measured(session.next_scan))
        seen = session_to_json(rest.session(session.id))
        assert_close(seen, session_to_json(grpc.session(session.id)))
        rest.cancel(session.id)
        told = list(rest.events(session.id))
        assert told[-1].type == "end"
        assert told == list(grpc.events(session.id))


def assert_close(a: Any, b: Any) -> None:
    """Equal, numbers to 1e-9."""
    if isinstance(a, dict):
        assert a.keys() == b.keys()
        for name in a:
            assert_close(a[name], b[name])
    elif isinstance(a, list):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            assert_close(x, y)
    elif isinstance(a, float):
        assert a == pytest.approx(b, abs=1e-9)
    else:
        assert a == b


def test_what_is_not_there_is_a_problem_too(orchestrator: Orchestrator) -> None:
    for method, path, status in [
        ("GET", "/v1/nothing", 404),
        ("PUT", "/v1/sessions", 405),
        ("POST", "/v1/sessions/x", 405),
        ("GET", "/v2/sessions", 404),
    ]:
        response = httpx.request(method, orchestrator.rest_url + path, timeout=10, trust_env=False)
        assert response.status_code == status
        assert response.headers["content-type"] == "application/problem+json"
        document = response.json()
        assert document["status"] == status
        assert all(document[name] for name in ("type", "title", "detail", "remedy"))
