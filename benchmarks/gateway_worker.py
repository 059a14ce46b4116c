"""A part of a benchmark in a process of its own, so that no interpreter's lock delays another part."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from multiprocessing import get_context
from typing import Any

from benchmarks.gateway_usage import Usage, usage_of

_START_TIMEOUT = 60.0
_END_TIMEOUT = 5.0


class Worker:
    """A process that runs `target(connection, *arguments)`: it tells one thing when it is ready, then answers commands
    until it is sent None. A context manager.

    Attributes:
        ready: what it told.

    Raises:
        RuntimeError: it ended, or was not ready in a minute.
    """

    def __init__(self, target: Callable[..., None], *arguments: Any) -> None:
        context = get_context("forkserver")
        context.set_forkserver_preload(["benchmarks.gateway_latency", "rich.progress"])
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=target, args=(theirs, *arguments), daemon=True)
        self._process.start()
        theirs.close()
        try:
            self.ready = self.answer(_START_TIMEOUT)
        except BaseException:
            self.__exit__()
            raise

    def usage(self) -> Usage:
        """What the process has used so far."""
        assert self._process.pid is not None
        return usage_of(self._process.pid)

    def tell(self, command: Any) -> None:
        """Gives a command, whose answer is to be taken later."""
        self._connection.send(command)

    def answer(self, timeout: float) -> Any:
        """The answer to the oldest command that has not been answered.

        Raises:
            RuntimeError: the process ended, or does not answer within `timeout` s.
        """
        if not self._connection.poll(timeout):
            raise RuntimeError(f"{self._process.name} does not answer")
        try:
            return self._connection.recv()
        except EOFError as error:
            raise RuntimeError(f"{self._process.name} ended; what it printed says why") from error

    def ask(self, command: Any, timeout: float) -> Any:
        """Gives a command and waits for its answer."""
        self.tell(command)
        return self.answer(timeout)

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):  # it has ended already
            self._connection.send(None)
        self._process.join(_END_TIMEOUT)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._connection.close()
