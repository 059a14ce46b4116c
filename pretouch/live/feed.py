"""What is new in the recording of an orchestrator's newest session."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pretouch.client import AsyncRestClient
from pretouch.errors import NotFound
from pretouch.recording.reader import Recorded, RecordingReader
from pretouch.recording.session_file import MAX_UNPACKED
from pretouch.session import Session


@dataclass(frozen=True)
class Update:
    """A session's recording, after something has happened.

    Attributes:
        whole: its messages.
        new: those that were not there before.
    """

    session_id: str
    whole: tuple[Recorded, ...]
    new: tuple[Recorded, ...]


class Feed:
    """Asks an orchestrator for its newest session, and for the recording only where that has changed.

    Args:
        folder: where it may keep a file.
    """

    def __init__(self, client: AsyncRestClient, folder: Path) -> None:
        self._client = client
        self._file = folder / "session.mcap"
        self._shown: tuple[Any, ...] = ()
        self._known: set[tuple[str, int, int]] = set()

    async def poll(self) -> Update | None:
        """What has happened since the last call, if anything; raises what the client raises."""
        sessions = (await self._client.sessions(1)).sessions
        if not sessions or (present := _describe(sessions[0])) == self._shown:
            return None
        session_id = sessions[0].id
        try:
            self._file.write_bytes(await self._client.recording(session_id))
        except NotFound:  # purged meanwhile
            return None
        if self._shown[:1] != present[:1]:
            self._known = set()
        self._shown = present
        whole = tuple(RecordingReader(self._file, MAX_UNPACKED))
        new = tuple(self._drop_known(whole))
        return Update(session_id, whole, new)

    def _drop_known(self, messages: Iterable[Recorded]) -> Iterable[Recorded]:
        """A message is known by its topic, its time, and its place among those of the same topic and time."""
        places = Counter[tuple[str, int]]()
        for message in messages:
            spot = message.topic, message.time
            key = (*spot, places[spot])
            places[spot] += 1
            if key not in self._known:
                self._known.add(key)
                yield message


def _describe(session: Session) -> tuple[Any, ...]:
    """What changes with every step; the id first."""
    planned = None if session.next_scan is None else session.next_scan.scan_id
    return session.id, session.state, len(session.scans), planned
