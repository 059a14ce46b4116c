"""Writes a recording: one MCAP file with compressed chunks, an index and every schema that it needs."""

from __future__ import annotations

from collections.abc import Iterable

from pretouch.cancellation import check_cancelled
from pretouch.recording.reader import Recorded
from pretouch.recording.schema import describe_schema
from pretouch.recording.writer import write_messages
from pretouch_orchestrator.recording.messages import Entry, list_entries
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store.protocol import NewEvent


def write_recording(record: Record, events: Iterable[NewEvent]) -> bytes:
    """The file of a session, in whatever state; see `list_entries`."""
    return write_messages(_serialise(entry) for entry in list_entries(record, events))


def _serialise(entry: Entry) -> Recorded:
    check_cancelled()
    kind = type(entry.message)
    data = entry.message.SerializeToString(deterministic=True)
    return Recorded(entry.topic, kind.DESCRIPTOR.full_name, describe_schema(kind), entry.time, data)
