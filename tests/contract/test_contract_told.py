"""Samples told while the robot moves, over REST and gRPC: they count once, and are enough once the tolerance is met."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.box_session import DEPTH, MASK, ROOMY, request
from helpers.fake_upstream import DEVICE, FakeUpstream
from helpers.told_scans import NOTHING, PIECE, chunk, measured

from pretouch.errors import Conflict, InvalidInput, NotFound, TooLarge
from pretouch.estimate import Estimate
from pretouch.session import Budget, GatewaySpan, Points, SampleChunk, ScanProgress, Skipped, State
from pretouch.tof import MAX_SAMPLES, RangeSamples
from pretouch.wire.json import session_to_json

roomy = request(budget=Budget(**ROOMY))
SPAN = GatewaySpan(DEVICE, 100.0, 200.0)


def certain(estimate: Estimate) -> Estimate:
    return replace(estimate, error_quantile=0.002)


def certain_after(samples: int) -> Callable[[Estimate], Estimate]:
    """Estimates from at least so many samples meet the tolerance."""
    return lambda estimate: certain(estimate) if estimate.samples >= samples else estimate


def returned(samples: RangeSamples) -> int:
    return int(np.isfinite(samples.range).sum())


async def follow(client: Any, session_id: str, scan_id: str, done: Callable[[ScanProgress], bool]) -> ScanProgress:
    """Asks for the progress until it is as expected: assessments are made in the background."""
    async with asyncio.timeout(30):
        while not done(progress := await client.tell(session_id, scan_id, SampleChunk(0, NOTHING))):
            pass
    return progress


async def test_told_samples_and_the_rest_are_one_scan(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    samples = measured(plan)
    first = await client.tell(session.id, plan.scan_id, chunk(samples, 0, PIECE))
    assert first == ScanProgress(PIECE, False, session.estimate.expected_error, session.estimate.error_quantile)
    assert (await client.tell(session.id, plan.scan_id, chunk(samples, PIECE, 3 * PIECE))).told == 3 * PIECE
    assert session_to_json(await client.session(session.id)) == session_to_json(session)
    after = await client.submit(session.id, plan.scan_id, samples.select(slice(3 * PIECE, None)))
    (scan,) = after.scans
    assert (scan.samples, scan.returns) == (len(samples), returned(samples))
    assert scan.duration == after.budget_used.seconds == pytest.approx(samples.t[-1] - samples.t[0])
    assert scan.length == pytest.approx(plan.path.length, rel=0.02)
    again = await client.submit(session.id, plan.scan_id, samples)
    assert session_to_json(again) == session_to_json(after)


async def test_a_scan_that_is_left_early_counts_what_was_flown(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    samples = measured(plan)
    part = samples.select(slice(0, 3 * PIECE))
    await client.tell(session.id, plan.scan_id, SampleChunk(0, part))
    after = await client.submit(session.id, plan.scan_id, NOTHING)
    (scan,) = after.scans
    tips = part.base_T_tip[:, :3, 3]
    assert scan.samples == len(part)
    assert scan.duration == after.budget_used.seconds == pytest.approx(part.t[-1] - part.t[0])
    assert scan.length == pytest.approx(np.linalg.norm(np.diff(tips, axis=0), axis=1).sum())
    assert scan.duration < plan.path.duration / 2


async def test_samples_are_enough_once_the_session_would_converge(client: Any, fakes: FakeUpstream) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    samples = measured(plan)
    with fakes.estimating(certain_after(3 * PIECE)):
        await client.tell(session.id, plan.scan_id, chunk(samples, 0, 20))
        before = session.estimate.expected_error
        progress = await follow(client, session.id, plan.scan_id, lambda known: known.expected_error < before)
        assert not progress.enough
        await client.tell(session.id, plan.scan_id, chunk(samples, 20, 4 * PIECE))
        progress = await follow(client, session.id, plan.scan_id, lambda known: known.enough)
        assert (progress.told, progress.error_quantile) == (4 * PIECE, 0.002)
        after = await client.submit(session.id, plan.scan_id, NOTHING)
    assert after.state is State.CONVERGED
    assert after.budget_used.seconds < plan.path.duration / 2


async def test_a_robot_that_stops_late_has_its_samples_counted(client: Any, fakes: FakeUpstream) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    samples = measured(plan)
    with fakes.estimating(certain):
        await client.tell(session.id, plan.scan_id, chunk(samples, 0, 3 * PIECE))
        await follow(client, session.id, plan.scan_id, lambda known: known.enough)
        late = await client.tell(session.id, plan.scan_id, chunk(samples, 3 * PIECE, 5 * PIECE))
        assert (late.told, late.enough) == (5 * PIECE, True)
        after = await client.submit(session.id, plan.scan_id, samples.select(slice(5 * PIECE, 6 * PIECE)))
    assert (after.state, after.scans[0].samples) == (State.CONVERGED, 6 * PIECE)


async def test_telling_does_not_wait_for_a_step_of_another_session(client: Any, fakes: FakeUpstream) -> None:
    slow, session = [await client.create_session(roomy, DEPTH, MASK) for _ in range(2)]
    with fakes.held("Register"):
        step = asyncio.create_task(client.submit(slow.id, slow.next_scan.scan_id, measured(slow.next_scan)))
        await asyncio.to_thread(fakes.wait_for_call, "Register")
        progress = await client.tell(session.id, session.next_scan.scan_id, chunk(measured(session.next_scan), 0, 24))
        assert (progress.told, step.done()) == (24, False)
    assert len((await step).scans) == 1


async def test_too_few_samples_are_never_enough(client: Any, fakes: FakeUpstream) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    registrations = fakes.count("Register")
    with fakes.estimating(certain):
        progress = await client.tell(session.id, plan.scan_id, chunk(measured(plan), 0, 19))
    assert (progress.told, progress.enough) == (19, False)
    assert fakes.count("Register") == registrations


@pytest.mark.parametrize("doubt", [{"fit": 0.001}, {"sensor_problem": "All 40 ranges are 31.2 mm: it is stuck."}])
async def test_doubtful_samples_are_not_enough(client: Any, fakes: FakeUpstream, doubt: dict[str, Any]) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    with fakes.estimating(lambda estimate: replace(certain(estimate), **doubt)):
        await client.tell(session.id, plan.scan_id, chunk(measured(plan), 0, 5 * PIECE))
        progress = await follow(client, session.id, plan.scan_id, lambda known: known.error_quantile == 0.002)
    assert not progress.enough


async def test_repeated_and_overlapping_chunks_count_once_and_the_first_counts(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    samples = measured(plan)
    blind = replace(samples, range=np.full(len(samples), np.nan))
    for telling, told in (
        (chunk(samples, 0, 16), 16),
        (chunk(samples, 0, 16), 16),
        (chunk(blind, 4, 12), 16),
        (chunk(blind, 8, 20), 20),
        (chunk(samples, 0), len(samples)),
    ):
        assert (await client.tell(session.id, plan.scan_id, telling)).told == told
    after = await client.submit(session.id, plan.scan_id, NOTHING)
    assert after.scans[0].samples == len(samples)
    assert after.scans[0].returns == returned(samples) - returned(samples.select(slice(16, 20)))


async def test_two_connections_that_tell_the_same_at_once_count_once(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    samples = measured(plan)
    tellings = [client.tell(session.id, plan.scan_id, chunk(samples, 0, 16)) for _ in range(4)]
    assert [progress.told for progress in await asyncio.gather(*tellings)] == [16] * 4


async def test_a_missing_chunk_is_named(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    samples = measured(plan)
    await client.tell(session.id, plan.scan_id, chunk(samples, 0, 8))
    with pytest.raises(Conflict, match="told is 8") as caught:
        await client.tell(session.id, plan.scan_id, chunk(samples, 16, 24))
    assert "number 8" in caught.value.remedy
    assert (await client.tell(session.id, plan.scan_id, chunk(samples, 8, 24))).told == 24


async def test_samples_that_go_back_in_time_are_refused(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    samples = measured(plan)
    await client.tell(session.id, plan.scan_id, chunk(samples, 0, 16))
    with pytest.raises(InvalidInput, match="before the last sample"):
        await client.tell(session.id, plan.scan_id, SampleChunk(16, samples.select(slice(8, 24))))
    with pytest.raises(InvalidInput, match="before the last sample"):
        await client.submit(session.id, plan.scan_id, samples)
    after = await client.submit(session.id, plan.scan_id, samples.select(slice(16, None)))
    assert after.scans[0].samples == len(samples)


async def test_samples_that_do_not_fit_are_refused_when_they_are_told(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    samples = measured(plan).select(slice(0, 8))
    for wrong, word in (
        (replace(samples, range=np.full(8, 0.001)), "range_min"),
        (replace(samples, module=np.full(8, 3)), "module 3"),
    ):
        with pytest.raises(InvalidInput, match=word):
            await client.tell(session.id, plan.scan_id, SampleChunk(0, wrong))
    assert (await client.tell(session.id, plan.scan_id, SampleChunk(0, samples))).told == 8


async def test_a_scan_has_no_more_samples_than_one_that_is_submitted(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    one = measured(plan).select(slice(0, 1))
    many = RangeSamples.concatenate([one] * (MAX_SAMPLES - 1))
    await client.tell(session.id, plan.scan_id, SampleChunk(0, many))
    with pytest.raises(TooLarge, match=str(MAX_SAMPLES)):
        await client.tell(session.id, plan.scan_id, SampleChunk(MAX_SAMPLES - 1, RangeSamples.concatenate([one] * 2)))
    assert (await client.tell(session.id, plan.scan_id, SampleChunk(0, one))).told == MAX_SAMPLES - 1


async def test_nothing_told_and_nothing_sent_is_no_scan(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    assert (await client.tell(session.id, plan.scan_id, SampleChunk(0, NOTHING))).told == 0
    with pytest.raises(InvalidInput, match="empty"):
        await client.submit(session.id, plan.scan_id, NOTHING)


async def test_a_closed_scan_takes_no_more_samples(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    samples = measured(plan)
    await client.tell(session.id, plan.scan_id, chunk(samples, 0, 24))
    after = await client.submit(session.id, plan.scan_id, NOTHING)
    with pytest.raises(Conflict, match="closed") as caught:
        await client.tell(session.id, plan.scan_id, chunk(samples, 24))
    assert "next_scan" in caught.value.remedy
    following = await client.tell(session.id, after.next_scan.scan_id, SampleChunk(0, NOTHING))
    assert (following.told, following.expected_error) == (0, after.estimate.expected_error)


async def test_an_ended_session_takes_no_more_samples(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    await client.tell(session.id, plan.scan_id, chunk(measured(plan), 0, 24))
    await client.cancel(session.id)
    with pytest.raises(Conflict, match="cancelled"):
        await client.tell(session.id, plan.scan_id, chunk(measured(plan), 24))


async def test_samples_of_an_unknown_scan_are_not_found(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    samples = measured(session.next_scan)
    for session_id, scan_id in ((session.id, "no-such-scan"), ("no-such-session", "scan-1")):
        with pytest.raises(NotFound, match="no-such"):
            await client.tell(session_id, scan_id, chunk(samples, 0, 8))


async def test_a_skipped_scan_drops_what_was_told(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    await client.tell(session.id, plan.scan_id, chunk(measured(plan), 0, 24))
    after = await client.submit(session.id, plan.scan_id, Skipped())
    assert (after.scans, after.budget_used.scans, after.budget_used.seconds) == ((), 0, 0.0)
    samples = measured(after.next_scan)
    after = await client.submit(session.id, after.next_scan.scan_id, samples)
    assert after.scans[0].samples == len(samples)


async def test_points_cannot_follow_samples(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    await client.tell(session.id, plan.scan_id, chunk(measured(plan), 0, 24))
    with pytest.raises(InvalidInput, match="24 samples were told"):
        await client.submit(session.id, plan.scan_id, Points(np.zeros((3, 3))))
    assert (await client.submit(session.id, plan.scan_id, NOTHING)).scans[0].samples == 24


@pytest.fixture
def gateway(fakes: FakeUpstream) -> Iterator[Callable[[RangeSamples], None]]:
    """Sets what the gateway holds."""

    def hold(samples: RangeSamples) -> None:
        fakes.samples = samples

    yield hold
    fakes.samples = NOTHING


@pytest.mark.parametrize("close_with_span", [False, True])
async def test_spans_of_the_gateway_are_told_in_any_order_and_count_once(
    client: Any, gateway: Callable[[RangeSamples], None], close_with_span: bool
) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    samples = measured(plan)
    for held, told in (
        (NOTHING, 0),
        (samples.select(slice(8, 16)), 8),
        (samples.select(slice(0, 20)), 20),
        (samples.select(slice(0, 20)), 20),
        (samples.select(slice(4, 40)), 40),
    ):
        gateway(held)
        assert (await client.tell(session.id, plan.scan_id, SPAN)).told == told
    gateway(samples)
    after = await client.submit(session.id, plan.scan_id, SPAN if close_with_span else NOTHING)
    expected = samples if close_with_span else samples.select(slice(0, 40))
    assert (after.scans[0].samples, after.scans[0].returns) == (len(expected), returned(expected))
    assert after.scans[0].duration == pytest.approx(expected.t[-1] - expected.t[0])


async def test_a_span_of_an_unknown_device_changes_nothing(client: Any) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    with pytest.raises(NotFound, match="thumb"):
        await client.tell(session.id, session.next_scan.scan_id, GatewaySpan("thumb", 1.0, 2.0))


async def test_a_registrar_that_fails_does_not_stop_the_telling(client: Any, fakes: FakeUpstream) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    samples = measured(plan)
    fakes.fail("Register", InvalidInput("a scan of nonsense", "mend it"))
    progress = await client.tell(session.id, plan.scan_id, chunk(samples, 0, 24))
    assert (progress.told, progress.expected_error) == (24, session.estimate.expected_error)
    await client.tell(session.id, plan.scan_id, chunk(samples, 24, 48))
    await follow(client, session.id, plan.scan_id, lambda known: known.expected_error < session.estimate.expected_error)


async def test_an_answer_does_not_wait_for_a_slow_registration_and_registrations_do_not_pile_up(
    client: Any, fakes: FakeUpstream
) -> None:
    session = await client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    samples = measured(plan)
    before = fakes.count("Register")
    with fakes.held("Register"):
        for k in range(3, 9):
            progress = await client.tell(session.id, plan.scan_id, chunk(samples, PIECE * (k - 1) * (k > 3), PIECE * k))
            assert (progress.told, progress.enough) == (PIECE * k, False)
        assert fakes.count("Register") == before + 1
    await follow(client, session.id, plan.scan_id, lambda known: fakes.count("Register") == before + 2)
    newest = [call.request for call in fakes.calls if call.method == "Register"][-1]
    assert list(newest.scans[-1].ranges.shape) == [8 * PIECE]
    assert fakes.count("Register") == before + 2
