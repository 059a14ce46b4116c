"""The records used last, kept in memory together with what their scenes have computed lazily."""

from __future__ import annotations

from collections import OrderedDict

from pretouch_orchestrator.sessions.record import Record

MAX_PIXELS = 16_000_000
"""Pixels of all scenes that are kept: some 32 bytes each."""


class RecordCache:
    """Keeps records. None is to be trusted before its version was compared with the store's."""

    def __init__(self) -> None:
        self._records: OrderedDict[str, Record] = OrderedDict()
        self._pixels = 0

    def get(self, session_id: str) -> Record | None:
        return self._records.get(session_id)

    def keep(self, record: Record) -> None:
        """Keeps the record unless a newer one of its session is there; drops those used longest ago."""
        known = self._records.get(record.id)
        if known is None or known.version <= record.version:
            self.drop(record.id)
            self._records[record.id] = record
            self._pixels += record.scene.mask.size
        else:
            self._records.move_to_end(record.id)
        while self._pixels > MAX_PIXELS and len(self._records) > 1:
            self.drop(next(iter(self._records)))

    def drop(self, session_id: str) -> None:
        known = self._records.pop(session_id, None)
        if known is not None:
            self._pixels -= known.scene.mask.size
