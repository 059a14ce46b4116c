"""Sessions to record, and what is found in their recordings."""

from __future__ import annotations

import io
from collections import defaultdict
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from pretouch_orchestrator.recording.file import write_recording
from pretouch_orchestrator.sessions.events import derive_events
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store.protocol import NewEvent
from pretouch_orchestrator.upstream.interfaces import Registrar

from helpers.loop_fakes import FormulaRegistrar, RandomDetector, answer, asked, opened, samples_of
from pretouch.geometry import Array
from pretouch.session import Budget, Tolerance


def recorded_session(
    scans: int = 3, registrar: Registrar | None = None, **changes: Any
) -> tuple[Record, list[NewEvent]]:
    """A session that has made `scans` scans at most, and its events."""
    loop = Loop(RandomDetector(), registrar or FormulaRegistrar())
    wanted = {"tolerance": Tolerance(0.0005), "budget": Budget(scans=max(scans, 1), fraction=1.0)} | changes
    record = opened(loop, asked(**wanted))
    events = derive_events(None, record.to_session())
    while record.next_scan is not None and len(record.scans) < scans:
        before, record = record, answer(loop, record, samples_of(record))
        events += derive_events(before.to_session(), record.to_session())
    return record, events


def read_messages(file: bytes) -> dict[str, list[Any]]:
    """The decoded messages of each topic, in the order of their times."""
    found = defaultdict(list)
    reader = make_reader(io.BytesIO(file), validate_crcs=True, decoder_factories=[DecoderFactory()])
    for _, channel, _, message in reader.iter_decoded_messages():
        found[channel.topic].append(message)
    return found


def record_messages(record: Record, events: list[NewEvent]) -> dict[str, list[Any]]:
    return read_messages(write_recording(record, events))


def points_of(cloud: Any) -> Array:
    """(n, 3), m."""
    return np.frombuffer(cloud.data, "<f4").reshape(-1, 3).astype(np.float64)
