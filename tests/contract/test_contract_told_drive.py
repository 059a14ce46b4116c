"""`drive` with a robot that yields its samples while it moves: told at once, stopped in time, closed in any case."""

from __future__ import annotations

from collections.abc import AsyncIterator, Generator, Iterator
from typing import Any

import pytest
from helpers.box_session import DEPTH, MASK, ROOMY, request
from helpers.client_kinds import opened
from helpers.fake_upstream import DEVICE, FakeUpstream
from helpers.processes import Orchestrator
from helpers.told_scans import NOTHING, PIECE, StreamingRobot, chunk, measured, pieces
from test_contract_told import certain

from pretouch.client import GrpcClient, RestClient, ScanPiece, SyncClient, drive, drive_async
from pretouch.errors import Conflict, InvalidInput, Unavailable
from pretouch.session import Budget, GatewaySpan, SampleChunk, ScanPlan, Skipped, State

roomy = request(budget=Budget(**ROOMY))
one_scan, two_scans = (request(budget=Budget(scans=n, seconds=1e5, fraction=1.0)) for n in (1, 2))


@pytest.fixture(params=["rest", "grpc"])
def client(request: pytest.FixtureRequest, orchestrator: Orchestrator) -> Iterator[SyncClient[Any, Any]]:
    with (
        RestClient(orchestrator.rest_url) if request.param == "rest" else GrpcClient(orchestrator.address)
    ) as opened_client:
        yield opened_client


@pytest.fixture(params=["rest-async", "grpc-async"])
async def async_client(request: pytest.FixtureRequest, orchestrator: Orchestrator) -> AsyncIterator[Any]:
    async with opened(request.param, orchestrator.rest_url, orchestrator.address) as opened_client:
        yield opened_client


def test_a_robot_that_is_never_told_to_stop_scans_to_its_end(client: SyncClient[Any, Any]) -> None:
    robot = StreamingRobot()
    states = list(drive(client, client.create_session(two_scans, DEPTH, MASK), robot.scan))
    assert [each.state for each in states] == [State.AWAITING_SCAN] * 2 + [State.EXHAUSTED]
    plans = [each.next_scan for each in states[:-1]]
    assert [scan.samples for scan in states[-1].scans] == [len(measured(plan)) for plan in plans if plan is not None]
    assert robot.stopped == 2


async def test_the_same_for_asyncio(async_client: Any) -> None:
    robot = StreamingRobot()
    session = await async_client.create_session(two_scans, DEPTH, MASK)
    states = [each async for each in drive_async(async_client, session, robot.scan_async)]
    assert [each.state for each in states] == [State.AWAITING_SCAN] * 2 + [State.EXHAUSTED]
    assert robot.stopped == 2


def test_the_robot_is_stopped_when_its_samples_are_enough(client: SyncClient[Any, Any], fakes: FakeUpstream) -> None:
    session = client.create_session(roomy, DEPTH, MASK)
    assert session.next_scan is not None
    robot = StreamingRobot()
    with fakes.estimating(certain):
        *_, last = drive(client, session, robot.scan)
    assert (last.state, robot.stopped) == (State.CONVERGED, 1)
    assert robot.yielded < len(pieces(measured(session.next_scan)))
    assert last.scans[0].duration < session.next_scan.path.duration
    assert last.scans[0].samples == robot.yielded * PIECE


async def test_the_robot_is_stopped_in_asyncio_too(async_client: Any, fakes: FakeUpstream) -> None:
    session = await async_client.create_session(roomy, DEPTH, MASK)
    robot = StreamingRobot()
    with fakes.estimating(certain):
        *_, last = [each async for each in drive_async(async_client, session, robot.scan_async)]
    assert (last.state, robot.stopped) == (State.CONVERGED, 1)
    assert last.scans[0].samples == robot.yielded * PIECE < len(measured(session.next_scan))


def test_a_robot_that_cannot_go_on_skips_the_scan(client: SyncClient[Any, Any]) -> None:
    def scan(plan: ScanPlan) -> Generator[ScanPiece, None, None]:
        yield measured(plan).select(slice(0, PIECE))
        yield Skipped()

    *_, last = drive(client, client.create_session(roomy, DEPTH, MASK), scan)
    assert (last.state, last.scans) == (State.EXHAUSTED, ())


def test_a_robot_that_yields_nothing_has_made_no_scan(client: SyncClient[Any, Any]) -> None:
    def scan(plan: ScanPlan) -> Generator[ScanPiece, None, None]:
        yield from ()

    with pytest.raises(InvalidInput, match="empty"):
        list(drive(client, client.create_session(roomy, DEPTH, MASK), scan))


def test_a_fault_of_the_robot_stops_it_and_loses_nothing_told(client: SyncClient[Any, Any]) -> None:
    session = client.create_session(roomy, DEPTH, MASK)
    assert session.next_scan is not None
    robot = StreamingRobot()

    def scan(plan: ScanPlan) -> Generator[ScanPiece, None, None]:
        for piece in robot.scan(plan):
            yield piece
            if robot.yielded == 2:
                raise RuntimeError("the arm is in the way")

    with pytest.raises(RuntimeError):
        list(drive(client, session, scan))
    assert client.tell(session.id, session.next_scan.scan_id, SampleChunk(0, NOTHING)).told == 2 * PIECE


def test_a_scan_that_another_program_left_open_is_closed_without_a_move(client: SyncClient[Any, Any]) -> None:
    session = client.create_session(roomy, DEPTH, MASK)
    plan = session.next_scan
    assert plan is not None
    client.tell(session.id, plan.scan_id, chunk(measured(plan), 0, 30))
    robot = StreamingRobot()
    following = drive(client, session, robot.scan)
    next(following)
    after = next(following)
    assert (after.scans[0].samples, robot.yielded) == (30, 0)
    *_, last = following
    assert last.state is State.CONVERGED


def test_a_cancelled_session_stops_the_robot(client: SyncClient[Any, Any]) -> None:
    session = client.create_session(roomy, DEPTH, MASK)
    robot = StreamingRobot()

    def scan(plan: ScanPlan) -> Generator[ScanPiece, None, None]:
        for piece in robot.scan(plan):
            if robot.yielded == 2:
                client.cancel(session.id)
            yield piece

    with pytest.raises(Conflict, match="cancelled"):
        list(drive(client, session, scan))
    assert robot.yielded == 2


class Flaky:
    """A client whose tellings fail: some before they are sent, some after they were stored."""

    def __init__(self, client: SyncClient[Any, Any], lost: set[int], unanswered: set[int]) -> None:
        self._client = client
        self._lost, self._unanswered = lost, unanswered
        self.tellings = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._client, name)

    def tell(self, *args: Any, **options: Any) -> Any:
        self.tellings += 1
        if self.tellings in self._lost:
            raise Unavailable("gone", "wait")
        progress = self._client.tell(*args, **options)
        if self.tellings in self._unanswered:
            raise Unavailable("the answer is lost", "wait")
        return progress


@pytest.mark.parametrize(("lost", "unanswered"), [({3, 4}, set()), (set(), {3, 4}), ({2, 5}, {4, 6})])
def test_lost_tellings_and_lost_answers_change_nothing(
    client: SyncClient[Any, Any], lost: set[int], unanswered: set[int]
) -> None:
    session = client.create_session(one_scan, DEPTH, MASK)
    assert session.next_scan is not None
    flaky: Any = Flaky(client, lost, unanswered)
    *_, last = drive(flaky, session, StreamingRobot().scan)
    assert last.scans[0].samples == len(measured(session.next_scan))


def test_spans_of_the_gateway_are_told(client: SyncClient[Any, Any], fakes: FakeUpstream) -> None:
    session = client.create_session(one_scan, DEPTH, MASK)

    def scan(plan: ScanPlan) -> Generator[ScanPiece, None, None]:
        samples = measured(plan)
        for end in (20, 40, len(samples)):
            fakes.samples = samples.select(slice(0, end))
            yield GatewaySpan(DEVICE, 100.0, 100.0 + end)

    try:
        *_, last = drive(client, session, scan)
    finally:
        fakes.samples = NOTHING
    assert session.next_scan is not None
    assert last.scans[0].samples == len(measured(session.next_scan))
