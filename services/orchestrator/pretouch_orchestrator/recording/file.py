"""Writes a recording: one MCAP file with compressed chunks, an index and every schema that it needs."""

from __future__ import annotations

import io
from collections.abc import Iterable

from google.protobuf.message import Message
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from pretouch.cancellation import check_cancelled
from pretouch.recording.schema import describe_schema
from pretouch_orchestrator.recording.messages import Entry, list_entries
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store.protocol import NewEvent


def write_recording(record: Record, events: Iterable[NewEvent]) -> bytes:
    """The file of a session, in whatever state; see `list_entries`."""
    return write_entries(list_entries(record, events))


def write_entries(entries: Iterable[Entry]) -> bytes:
    """The file of these messages, in their order."""
    out = io.BytesIO()
    writer = Writer(out)
    writer.start(profile="", library="pretouch")
    schemas: dict[type[Message], int] = {}
    channels: dict[str, int] = {}
    for number, entry in enumerate(entries):
        check_cancelled()
        kind = type(entry.message)
        if kind not in schemas:
            schema = describe_schema(kind)
            schemas[kind] = writer.register_schema(kind.DESCRIPTOR.full_name, SchemaEncoding.Protobuf, schema)
        if entry.topic not in channels:
            channels[entry.topic] = writer.register_channel(entry.topic, MessageEncoding.Protobuf, schemas[kind])
        data = entry.message.SerializeToString(deterministic=True)
        writer.add_message(channels[entry.topic], entry.time, data, entry.time, number)
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()
