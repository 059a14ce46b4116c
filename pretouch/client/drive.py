"""The main loop of a robot program: scan until the session ends."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from typing import Any

from pretouch.client.asynchronous import AsyncClient
from pretouch.client.synchronous import SyncClient
from pretouch.session import ScanPlan, Session, Submission


def drive(
    client: SyncClient[Any, Any], session: Session, execute: Callable[[ScanPlan], Submission]
) -> Iterator[Session]:
    """Scans until `session` ends.

    Args:
        execute: moves the fingertip along the plan's path, poses `base_T_tip` with z along the beam, and returns
            what it measured, or `Skipped` if the path cannot be followed.

    Yields:
        The session: first as given, then after each scan; the last one has ended.
    """
    yield session
    while session.next_scan is not None:
        plan = session.next_scan
        session = client.submit(session.id, plan.scan_id, execute(plan))
        yield session


async def drive_async(
    client: AsyncClient[Any, Any], session: Session, execute: Callable[[ScanPlan], Awaitable[Submission]]
) -> AsyncIterator[Session]:
    """As `drive`, for asyncio."""
    yield session
    while session.next_scan is not None:
        plan = session.next_scan
        session = await client.submit(session.id, plan.scan_id, await execute(plan))
        yield session
