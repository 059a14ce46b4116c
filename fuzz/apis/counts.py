"""What was sent, what was answered, and what must not be."""

from __future__ import annotations

import threading
from collections import Counter


class Counts:
    """Counts requests and answers from several threads.

    Attributes:
        sent: requests, by method.
        answers: answers, by method and status.
        faults: broken invariants, each with how often it was met.
        inputs: the first messages that broke each, where it was a gRPC call.
    """

    def __init__(self) -> None:
        self.sent: Counter[str] = Counter()
        self.answers: Counter[tuple[str, str]] = Counter()
        self.faults: Counter[str] = Counter()
        self.inputs: dict[str, list[bytes]] = {}
        self._lock = threading.Lock()

    def send(self, method: str) -> None:
        with self._lock:
            self.sent[method] += 1

    def answer(self, method: str, status: str) -> None:
        with self._lock:
            self.answers[method, status] += 1

    def fault(self, what: str, messages: list[bytes] | None = None) -> None:
        with self._lock:
            self.faults[what] += 1
            if messages is not None:
                self.inputs.setdefault(what, messages)

    def add_up(self) -> bool:
        """Whether every request has one answer."""
        answered: Counter[str] = Counter()
        for (method, _), number in self.answers.items():
            answered[method] += number
        return answered == self.sent

    def lines(self) -> list[str]:
        """A table: each method, how often it was called, and how often each status was the answer."""
        table = []
        for method, number in sorted(self.sent.items()):
            statuses = sorted((status, count) for (name, status), count in self.answers.items() if name == method)
            table.append(f"{method:52} {number:6}  " + " ".join(f"{status}:{count}" for status, count in statuses))
        return [*table, f"{'all':52} {self.sent.total():6}  {self.answers.total()} answers"]
