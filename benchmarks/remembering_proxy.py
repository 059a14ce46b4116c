"""`python -m benchmarks.remembering_proxy PORT ADDRESS`: a gRPC service that remembers its answers.

A new request is passed on to ADDRESS, one that is known answered at once. Before a service whose work is expensive it
shows what those who call it need themselves, with real answers.
"""

from __future__ import annotations

import asyncio
import hashlib
import sys
from typing import Any

import grpc

_OPTIONS = [("grpc.max_receive_message_length", 64 << 20), ("grpc.max_send_message_length", 64 << 20)]


class RememberingProxy(grpc.GenericRpcHandler):  # type: ignore[misc]
    """All unary methods of the service behind `channel`; failures and health checks are not kept."""

    def __init__(self, channel: grpc.aio.Channel) -> None:
        self._channel = channel
        self._answers: dict[tuple[str, bytes], bytes] = {}

    def service(self, handler_call_details: grpc.HandlerCallDetails) -> grpc.RpcMethodHandler:
        method = handler_call_details.method

        async def answer(request: bytes, context: grpc.aio.ServicerContext[Any, Any]) -> bytes:
            key = (method, hashlib.sha256(request).digest())
            known = self._answers.get(key)
            if known is not None:
                return known
            try:
                response: bytes = await self._channel.unary_unary(method)(request, timeout=context.time_remaining())
            except grpc.aio.AioRpcError as error:
                await context.abort(error.code(), error.details() or "", tuple(error.trailing_metadata() or ()))
            if not method.startswith("/grpc.health"):
                self._answers[key] = response
            return response

        return grpc.unary_unary_rpc_method_handler(answer)


async def serve(port: int, address: str) -> None:
    async with grpc.aio.insecure_channel(address, options=_OPTIONS) as channel:
        server = grpc.aio.server(options=_OPTIONS)
        server.add_generic_rpc_handlers((RememberingProxy(channel),))
        server.add_insecure_port(f"127.0.0.1:{port}")
        await server.start()
        await server.wait_for_termination()


if __name__ == "__main__":
    asyncio.run(serve(int(sys.argv[1]), sys.argv[2]))
