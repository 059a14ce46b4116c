"""What the robots were answered, kept apart from the services: the truth that the store is compared with."""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import dataclass, field

from pretouch.session import ScanSummary, Session


@dataclass
class Entry:
    """One session as its robot knows it.

    Attributes:
        key: the idempotency key of its creation.
        over_grpc: whether the robot speaks gRPC, else REST.
        told: for each scan of which samples were told, how many the last answer counted.
        scans: what each scan's answer said of it, in order.
        last: the session as last answered; None until its creation was.
        abandoned: why the robot gave up.
    """

    key: str
    over_grpc: bool
    told: dict[str, int] = field(default_factory=dict)
    scans: list[ScanSummary] = field(default_factory=list)
    last: Session | None = None
    abandoned: str = ""


class Ledger:
    """All entries, and what calls met; safe for threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.entries: list[Entry] = []
        self.failures: Counter[str] = Counter()
        self.seconds: list[float] = []

    def open(self, key: str, *, over_grpc: bool) -> Entry:
        """A new entry, before its session is asked for."""
        entry = Entry(key, over_grpc)
        with self._lock:
            self.entries.append(entry)
        return entry

    def note_failure(self, error: Exception) -> None:
        """A call that failed even after the client's own retries; the robot makes it again."""
        with self._lock:
            self.failures[type(error).__name__] += 1

    def note_answer(self, seconds: float) -> None:
        """How long a step took, however often it had to be asked for."""
        with self._lock:
            self.seconds.append(seconds)

    @property
    def steps(self) -> int:
        """Answered scans."""
        with self._lock:
            return sum(len(entry.scans) for entry in self.entries)
