"""The chaos benchmark notices what it is there to notice: a step or a session that was lost, doubled or changed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.chaos.comparison import compare
from benchmarks.chaos.ledger import Entry, Ledger
from pretouch.client import Event
from pretouch.errors import NotFound
from pretouch.estimate import from_prior
from pretouch.prior import Prior
from pretouch.session import BudgetUsed, Planner, Proposer, ScanSummary, Session, State


def a_session(id: str, scans: int, state: State = State.CONVERGED) -> Session:
    summaries = tuple(ScanSummary(f"scan-{k}", "line-1", None, 30, 20, 0.1, 2.0, 0.004) for k in range(1, scans + 1))
    estimate = from_prior(Prior(), np.eye(3))
    return Session(id, state, Proposer.NARF, Planner.INFORMATION, (), estimate, None, summaries, BudgetUsed(scans))


class FakeStore:
    """A client of the sessions given."""

    def __init__(self, *sessions: Session) -> None:
        self.sessions = list(sessions)
        self.extra_events: list[str] = []

    def all_sessions(self) -> Iterator[Session]:
        yield from self.sessions

    def session(self, id: str) -> Session:
        for session in self.sessions:
            if session.id == id:
                return session
        raise NotFound(f"There is no session {id}.")

    def events(self, id: str) -> Iterator[Event]:
        kinds = ["session", *("scan" for _ in self.session(id).scans), *self.extra_events, "end"]
        yield from (Event(number, kind, {}) for number, kind in enumerate(kinds, start=1))


def compared(store: FakeStore, change: Callable[[Entry], None] = lambda entry: None) -> list[str]:
    """The differences from a robot that was answered two scans of session `a`."""
    ledger = Ledger()
    entry = ledger.open("robot-0, session 0", over_grpc=False)
    entry.last = a_session("a", 2)
    entry.scans = list(entry.last.scans)
    change(entry)
    client: Any = store
    counts, differences = compare(ledger, client, client)
    assert counts["steps answered"] == 2
    return differences


def test_what_agrees_has_no_differences() -> None:
    assert compared(FakeStore(a_session("a", 2))) == []


@pytest.mark.parametrize(
    ("store", "said"),
    [
        (FakeStore(), "There is no session a"),
        (FakeStore(a_session("a", 1)), "its scans are"),
        (FakeStore(a_session("a", 3)), "its scans are"),
        (FakeStore(a_session("a", 2), a_session("b", 0)), "belongs to no robot"),
        (FakeStore(a_session("a", 2), a_session("a", 2)), "in the store twice"),
        (FakeStore(a_session("a", 2, State.AWAITING_SCAN)), "its state is awaiting_scan"),
        (FakeStore(a_session("a", 2, State.FAILED)), "its state is failed"),
        (
            FakeStore(replace(a_session("a", 2), scans=(a_session("a", 1).scans[0],) * 2)),
            "its scans are",
        ),
    ],
    ids=[
        "lost session",
        "lost step",
        "unknown step",
        "doubled session",
        "twice",
        "not ended",
        "failed",
        "doubled step",
    ],
)
def test_what_was_lost_or_doubled_is_a_difference(store: FakeStore, said: str) -> None:
    assert said in " ".join(compared(store))


def test_a_changed_scan_an_event_too_many_and_lost_samples_are_differences() -> None:
    session = a_session("a", 2)
    changed = replace(session, scans=(replace(session.scans[0], samples=31), session.scans[1]))
    assert "changed after it was answered" in " ".join(compared(FakeStore(changed)))
    store = FakeStore(session)
    store.extra_events = ["scan"]
    assert "2 scans made the events" in " ".join(compared(store))
    assert "30 samples of 40 told" in " ".join(compared(store, lambda entry: entry.told.update({"scan-2": 40})))


def test_a_robot_that_gave_up_is_a_difference() -> None:
    def give_up(entry: Entry) -> None:
        entry.abandoned = "Internal: a defect"

    assert "given up" in " ".join(compared(FakeStore(a_session("a", 2)), give_up))
