"""A robot that runs whole sessions, one after the other, and insists on every answer."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from pretouch_simulation.demo import request_for
from pretouch_simulation.fingers.ideal import ThinBeam
from pretouch_simulation.protocol import Case, generator
from pretouch_simulation.scanning import cut_pieces, scan_along

from benchmarks.chaos.ledger import Entry, Ledger
from pretouch.client import GrpcClient, RestClient, SyncClient
from pretouch.errors import DeadlineExceeded, Overloaded, PretouchError, Unavailable
from pretouch.session import SampleChunk, ScanPlan
from pretouch.tof import RangeSamples

T = TypeVar("T")
_FINGER = ThinBeam()
_NOTHING = RangeSamples.concatenate([])
_AGAIN = 1.0  # s between two tries of a robot whose call failed
_PATIENCE = 300.0  # s in which every step must be answered
_TRANSIENT = (Unavailable, Overloaded, DeadlineExceeded)


class Robot(threading.Thread):
    """Number `number`: even ones speak REST, odd ones gRPC, and every third tells its samples while it moves.

    A robot that was told to stop finishes its session first.
    """

    def __init__(self, number: int, rest: str, grpc: str, cases: Sequence[Case], ledger: Ledger) -> None:
        super().__init__(name=f"robot-{number}", daemon=True)
        self._number = number
        self._over_grpc = bool(number % 2)
        self._client: SyncClient[Any, Any] = GrpcClient(grpc) if self._over_grpc else RestClient(rest)
        self._cases = cases
        self._ledger = ledger
        self._stopping = threading.Event()
        self._rng = generator("robot", number)

    def stop(self) -> None:
        self._stopping.set()

    def run(self) -> None:
        with self._client:
            session = 0
            while not self._stopping.is_set():
                entry = self._ledger.open(f"{self.name}, session {session}", over_grpc=self._over_grpc)
                try:
                    self._run_session(entry, self._cases[(self._number + session) % len(self._cases)])
                except Exception as error:
                    entry.abandoned = f"{type(error).__name__}: {error}"
                session += 1

    def _run_session(self, entry: Entry, case: Case) -> None:
        request = request_for(case, _FINGER.sensor)
        session = self._insist(lambda: self._client.create_session(request, case.depth.metres, case.mask, entry.key))
        entry.last, id = session, session.id
        while session.next_scan is not None:
            plan = session.next_scan
            samples = scan_along(case.world, plan.path, _FINGER.sensor, _FINGER, self._rng)
            if self._number % 3 == 0:
                self._tell(entry, id, plan, samples)
            rest = _NOTHING if plan.scan_id in entry.told else samples
            if rest is samples:
                time.sleep(plan.path.duration)  # the robot moves
            session = self._insist(lambda: self._client.submit(id, plan.scan_id, rest))  # noqa: B023
            entry.scans.append(session.scans[-1])
            entry.last = session

    def _tell(self, entry: Entry, session_id: str, plan: ScanPlan, samples: RangeSamples) -> None:
        start = 0
        for piece in cut_pieces(samples):
            time.sleep(piece.t[-1] - piece.t[0])
            chunk = SampleChunk(start, piece)
            progress = self._insist(lambda: self._client.tell(session_id, plan.scan_id, chunk))  # noqa: B023
            entry.told[plan.scan_id] = progress.told
            start = progress.told

    def _insist(self, call: Callable[[], T]) -> T:
        """The call's answer, however often it takes."""
        began = time.monotonic()
        while True:
            try:
                answer = call()
            except PretouchError as error:
                self._ledger.note_failure(error)
                if not isinstance(error, _TRANSIENT) or time.monotonic() > began + _PATIENCE:
                    raise
            else:
                self._ledger.note_answer(time.monotonic() - began)
                return answer
            time.sleep(_AGAIN)
