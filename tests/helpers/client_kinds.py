"""The four clients of the library behind one asynchronous interface, so that one test covers all of them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Generator
from contextlib import asynccontextmanager, closing
from typing import Any, cast

from pretouch.client import AsyncGrpcClient, AsyncRestClient, GrpcClient, RestClient, SyncClient
from pretouch.client.events import Event
from pretouch.session import Session

KINDS = ("rest", "rest-async", "grpc", "grpc-async")


class Threaded:
    """A synchronous client, each call in a thread of its own."""

    def __init__(self, client: SyncClient[Any, Any]) -> None:
        self._client = client

    def __getattr__(self, name: str) -> Callable[..., Awaitable[Any]]:
        method = getattr(self._client, name)

        async def call(*args: Any, **options: Any) -> Any:
            return await asyncio.to_thread(method, *args, **options)

        return call

    async def events(self, session_id: str, after: int = 0) -> AsyncGenerator[Event]:
        events = self._client.events(session_id, after)
        with closing(cast(Generator[Event], events)):
            while (event := await asyncio.to_thread(next, events, None)) is not None:
                yield event

    async def all_sessions(self) -> AsyncIterator[Session]:
        for session in await asyncio.to_thread(lambda: list(self._client.all_sessions())):
            yield session


@asynccontextmanager
async def opened(kind: str, rest_url: str, grpc_address: str, **options: Any) -> AsyncIterator[Any]:
    """A client of `kind` with the methods of the asynchronous ones."""
    match kind:
        case "rest":
            with RestClient(rest_url, **options) as client:
                yield Threaded(client)
        case "grpc":
            with GrpcClient(grpc_address, **options) as grpc_client:
                yield Threaded(grpc_client)
        case "rest-async":
            async with AsyncRestClient(rest_url, **options) as async_client:
                yield async_client
        case "grpc-async":
            async with AsyncGrpcClient(grpc_address, **options) as async_grpc_client:
                yield async_grpc_client
