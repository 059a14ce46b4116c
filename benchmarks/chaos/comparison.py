"""Compares what the store holds at the end with what the robots were answered."""

from __future__ import annotations

from collections import Counter
from typing import Any

from benchmarks.chaos.ledger import Entry, Ledger
from pretouch.client import GrpcClient, RestClient, SyncClient
from pretouch.errors import PretouchError
from pretouch.wire.json import session_to_json


def compare(ledger: Ledger, rest: RestClient, grpc: GrpcClient) -> tuple[dict[str, int], list[str]]:
    """Counts of both sides, and everything that differs: nothing, if all is well."""
    wrong: list[str] = []
    stored = [session.id for session in rest.all_sessions()]
    known = {entry.last.id: entry for entry in ledger.entries if entry.last is not None}
    wrong += [f"session {id} is in the store twice" for id, n in Counter(stored).items() if n > 1]
    wrong += [f"session {id} belongs to no robot: its creation was done twice" for id in stored if id not in known]
    wrong += [f"{entry.key}: given up: {entry.abandoned}" for entry in ledger.entries if entry.abandoned]
    if len(known) < sum(entry.last is not None for entry in ledger.entries):
        wrong.append("two creations were answered with the same session")
    states: Counter[str] = Counter()
    steps = 0
    for id, entry in known.items():
        try:
            # over the same wire as the robot: the two round poses differently
            found, differences = _compare_session(entry, grpc if entry.over_grpc else rest)
        except PretouchError as error:
            wrong.append(f"{entry.key}, session {id}: {error}")
            continue
        states[found["state"]] += 1
        steps += len(found["scans"])
        wrong += [f"{entry.key}, session {id}: {text}" for text in differences]
    counts = {
        "sessions asked for": len(ledger.entries),
        "sessions answered": len(known),
        "sessions in the store": len(stored),
        "steps answered": ledger.steps,
        "steps in the store": steps,
    }
    return counts | {f"sessions {state}": n for state, n in sorted(states.items())}, wrong


def _compare_session(entry: Entry, client: SyncClient[Any, Any]) -> tuple[dict[str, Any], list[str]]:
    assert entry.last is not None
    session = client.session(entry.last.id)
    found, answered = session_to_json(session), session_to_json(entry.last)
    wrong = []
    if not session.state.ended or found["state"] == "failed":
        wrong.append(f"its state is {found['state']}")
    if found != answered and not entry.abandoned:
        wrong.append(f"{[member for member in found if found[member] != answered[member]]} differ from the last answer")
    if [scan.scan_id for scan in session.scans] != [scan.scan_id for scan in entry.scans]:
        wrong.append(f"its scans are {[scan.scan_id for scan in session.scans]}, those answered {entry.scans}")
    if list(session.scans) != entry.scans:
        wrong.append("a scan changed after it was answered")
    for scan in session.scans:
        if entry.told.get(scan.scan_id, scan.samples) != scan.samples:
            wrong.append(f"{scan.scan_id} has {scan.samples} samples of {entry.told[scan.scan_id]} told")
    if not session.state.ended:
        return found, wrong  # its events do not end
    events = list(client.events(session.id))
    if [event.id for event in events] != list(range(1, len(events) + 1)):
        wrong.append(f"its events are numbered {[event.id for event in events]}")
    kinds = Counter(event.type for event in events)
    if kinds["scan"] != len(session.scans) or kinds["end"] != 1:
        wrong.append(f"{len(session.scans)} scans made the events {dict(kinds)}")
    return found, wrong
