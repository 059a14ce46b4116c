# Generated from pretouch/client/asynchronous by `make client`: change that.
"""The main loop of a robot program: scan until the session ends."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from typing import Any

from pretouch.client.synchronous.client import SyncClient
from pretouch.client.untold import NOTHING, Execution, ScanPiece, UntoldSamples
from pretouch.errors import DeadlineExceeded, Overloaded, Unavailable
from pretouch.session import ScanPlan, Session, Skipped, Submission

_TRANSIENT = (Unavailable, Overloaded, DeadlineExceeded)
_IN_FLIGHT = 2.0
"""s that telling may take while the robot moves; what is not told then goes along with the next piece."""


def drive(
    client: SyncClient[Any, Any], session: Session, execute: Callable[[ScanPlan], Execution]
) -> Iterator[Session]:
    """Scans until `session` ends.

    Args:
        execute: moves the fingertip along the plan's path, poses `base_T_tip` with z along the beam, and returns
            what it measured, or `Skipped` if the path cannot be followed. Or it is a generator that yields, while the
            tip moves, what was measured since: `RangeSamples`, a `GatewaySpan`, or at last `Skipped`. Each piece is
            told at once, and the generator is closed as soon as the samples are enough: stop the motion in its
            `finally`. It is closed before any error is raised, too. For an asynchronous client it is a coroutine
            function or an asynchronous generator.

    Yields:
        The session: first as given, then after each scan; the last one has ended.
    """
    yield session
    while session.next_scan is not None:
        plan = session.next_scan
        executed = execute(plan)
        if isinstance(executed, Generator):
            submission = _tell_pieces(client, session.id, plan.scan_id, executed)
        else:
            submission = executed
        session = client.submit(session.id, plan.scan_id, submission)
        yield session


def _tell_pieces(
    client: SyncClient[Any, Any], session_id: str, scan_id: str, pieces: Generator[ScanPiece, Any]
) -> Submission:
    """Tells the pieces until they are enough; what closes the scan.

    If another program has told samples of this scan, they close it, and the robot does not move.
    """
    untold, enough = UntoldSamples(), False
    with closing(pieces):
        if (client.tell(session_id, scan_id, untold.ask())).told > 0:
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
