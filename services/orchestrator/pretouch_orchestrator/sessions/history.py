"""How a session's estimate developed, from its events."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from pretouch.wire.json import estimate_to_json
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store.protocol import NewEvent


def list_estimates(record: Record, events: Iterable[NewEvent]) -> list[dict[str, Any]]:
    """The estimates as JSON: one before the first scan, and one after each.

    Args:
        events: those of types `scan` and `estimate`, the oldest first; others are passed over.
    """
    made, by_scan = 0, {}
    for event in events:
        if event.type == "scan":
            made += 1
        elif event.type == "estimate":
            by_scan[made] = event.data
    last = len(record.scans)
    by_scan[last] = estimate_to_json(record.estimate, None)
    known = by_scan.get(0, by_scan[last])
    listed = []
    for k in range(last + 1):
        known = by_scan.get(k, known)
        listed.append(known)
    return listed
