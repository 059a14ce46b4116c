"""Writes messages to an MCAP file: compressed chunks, an index, and every schema."""

from __future__ import annotations

import io
from collections.abc import Iterable

from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from pretouch.recording.reader import Recorded


def write_messages(messages: Iterable[Recorded]) -> bytes:
    """The file of these messages of protobuf, in their order; a topic has one schema."""
    out = io.BytesIO()
    writer = Writer(out)
    writer.start(profile="", library="pretouch")
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    for number, message in enumerate(messages):
        if message.schema not in schemas:
            schemas[message.schema] = writer.register_schema(message.schema, SchemaEncoding.Protobuf, message.described)
        if message.topic not in channels:
            channels[message.topic] = writer.register_channel(
                message.topic, MessageEncoding.Protobuf, schemas[message.schema]
            )
        writer.add_message(channels[message.topic], message.time, message.data, message.time, number)
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()
