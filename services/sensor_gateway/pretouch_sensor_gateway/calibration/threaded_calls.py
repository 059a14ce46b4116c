"""Makes gRPC calls in their own threads, so that Ctrl-C, which Python raises in the main thread, never interrupts gRPC.

An interrupt while a call is being created would leave it half registered with its channel, which then never closes.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import grpc

_T = TypeVar("_T")
_Arrived = queue.SimpleQueue[tuple[bool, Any]]


def call_in_thread(call: Callable[[], _T]) -> _T:
    """Runs `call` in a thread and returns its result.

    Raises:
        grpc.RpcError: what it raises.
    """
    arrived: _Arrived = queue.SimpleQueue()

    def run() -> None:
        try:
            arrived.put((True, call()))
        except grpc.RpcError as error:
            arrived.put((False, error))

    threading.Thread(target=run, daemon=True).start()
    good, what = arrived.get()
    if not good:
        raise what
    return what  # type: ignore[no-any-return]


@contextmanager
def stream_in_thread(call: Callable[[], Any]) -> Iterator[Iterator[Any]]:
    """Yields the responses of a streaming call, which ends with the block. Raises grpc.RpcError if it fails."""
    arrived: _Arrived = queue.SimpleQueue()
    opened: queue.SimpleQueue[Any] = queue.SimpleQueue()

    def run() -> None:
        responses = call()
        opened.put(responses)
        try:
            for response in responses:
                arrived.put((True, response))
            arrived.put((True, None))
        except grpc.RpcError as error:
            arrived.put((False, error))

    def receive() -> Iterator[Any]:
        while True:
            good, what = arrived.get()
            if not good:
                raise what
            if what is None:
                return
            yield what

    reader = threading.Thread(target=run, daemon=True)
    reader.start()
    try:
        yield receive()
    finally:
        opened.get().cancel()
        reader.join()
