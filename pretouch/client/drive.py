"""The main loop of a robot program: scan until the session ends."""

from __future__ import annotations

from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Generator, Iterator
from contextlib import aclosing, closing
from typing import Any

from pretouch.client.asynchronous import AsyncClient
from pretouch.client.synchronous import SyncClient
from pretouch.client.untold import NOTHING, ScanPiece, UntoldSamples
from pretouch.errors import DeadlineExceeded, Overloaded, Unavailable
from pretouch.session import ScanPlan, Session, Skipped, Submission

__all__ = ["ScanPiece", "drive", "drive_async"]

_TRANSIENT = (Unavailable, Overloaded, DeadlineExceeded)
_IN_FLIGHT = 2.0
"""s that telling may take while the robot moves; what is not told then goes along with the next piece."""


def drive(
    client: SyncClient[Any, Any],
    session: Session,
    execute: Callable[[ScanPlan], Submission | Generator[ScanPiece, Any, Any]],
) -> Iterator[Session]:
    """Scans until `session` ends.

    Args:
        execute: moves the fingertip along the plan's path, poses `base_T_tip` with z along the beam, and returns
            what it measured, or `Skipped` if the path cannot be followed. Or it is a generator that yields, while the
            tip moves, what was measured since: `RangeSamples`, a `GatewaySpan`, or at last `Skipped`. Each piece is
            told at once, and the generator is closed as soon as the samples are enough: stop the motion in its
            `finally`. It is closed before any error is raised, too.

    Yields:
        The session: first as given, then after each scan; the last one has ended.
    """
    yield session
    while session.next_scan is not None:
        plan = session.next_scan
        executed = execute(plan)
        if isinstance(executed, Generator):
            executed = _tell_pieces(client, session.id, plan.scan_id, executed)
        session = client.submit(session.id, plan.scan_id, executed)
        yield session


async def drive_async(
    client: AsyncClient[Any, Any],
    session: Session,
    execute: Callable[[ScanPlan], Awaitable[Submission] | AsyncGenerator[ScanPiece, Any]],
) -> AsyncIterator[Session]:
    """As `drive`, for asyncio: `execute` is a coroutine function or an asynchronous generator."""
    yield session
    while session.next_scan is not None:
        plan = session.next_scan
        executed = execute(plan)
        if isinstance(executed, AsyncGenerator):
            submission = await _tell_pieces_async(client, session.id, plan.scan_id, executed)
        else:
            submission = await executed
        session = await client.submit(session.id, plan.scan_id, submission)
        yield session


def _tell_pieces(
    client: SyncClient[Any, Any], session_id: str, scan_id: str, pieces: Generator[ScanPiece, Any, Any]
) -> Submission:
    """Tells the pieces until they are enough; what closes the scan.

    If another program has told samples of this scan, they close it, and the robot does not move.
    """
    untold, enough = UntoldSamples(), False
    with closing(pieces):
        if client.tell(session_id, scan_id, untold.ask()).told > 0:
            return NOTHING
        for piece in pieces:
            if isinstance(piece, Skipped):
                return piece
            untold.add(piece)
            try:
                while not enough and (telling := untold.next()) is not None:
                    enough = untold.note(client.tell(session_id, scan_id, telling, timeout=_IN_FLIGHT))
            except _TRANSIENT:
                continue
            if enough:
                break
    while (telling := untold.next()) is not None:
        untold.note(client.tell(session_id, scan_id, telling))
    return NOTHING


async def _tell_pieces_async(
    client: AsyncClient[Any, Any], session_id: str, scan_id: str, pieces: AsyncGenerator[ScanPiece, Any]
) -> Submission:
    """As `_tell_pieces`."""
    untold, enough = UntoldSamples(), False
    async with aclosing(pieces):
        if (await client.tell(session_id, scan_id, untold.ask())).told > 0:
            return NOTHING
        async for piece in pieces:
            if isinstance(piece, Skipped):
                return piece
            untold.add(piece)
            try:
                while not enough and (telling := untold.next()) is not None:
                    enough = untold.note(await client.tell(session_id, scan_id, telling, timeout=_IN_FLIGHT))
            except _TRANSIENT:
                continue
            if enough:
                break
    while (telling := untold.next()) is not None:
        untold.note(await client.tell(session_id, scan_id, telling))
    return NOTHING
