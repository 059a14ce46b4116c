"""Failures of gRPC calls become the errors of pretouch."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager

import grpc

from pretouch.errors import from_rpc_error, unreachable


@contextmanager
def raising_rpc_errors() -> Iterator[None]:
    """Also where the channel was closed meanwhile: gRPC then cancels the call, not the task that waits for it."""
    try:
        yield
    except grpc.RpcError as error:
        raise from_rpc_error(error) from error
    except asyncio.CancelledError as error:
        task = asyncio.current_task()
        if task is None or task.cancelling():
            raise
        raise unreachable("The call was cancelled.") from error
