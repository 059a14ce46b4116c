"""A server that answers every request with whatever the test says, over HTTP or gRPC, however wrong."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Iterator
from concurrent import futures
from dataclasses import dataclass
from typing import Any

import grpc

from pretouch.errors import PROBLEM_METADATA_KEY


@dataclass
class HttpFault:
    """What a connection gets once its first bytes have come.

    Attributes:
        payload: bytes of the answer.
        ending: "close" it then, "reset" it, "wait" until the server stops, or go on "drip" by drip until then.
    """

    payload: bytes = b""
    ending: str = "close"


class HostileHttp:
    """`fault` is given to every connection."""

    def __init__(self) -> None:
        self.fault = HttpFault()
        self._stopped = threading.Event()

    def __enter__(self) -> HostileHttp:
        self._listener = socket.create_server(("127.0.0.1", 0), backlog=512)
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._listener.accept()
                threading.Thread(target=self._answer, args=(connection, self.fault), daemon=True).start()

    def _answer(self, connection: socket.socket, fault: HttpFault) -> None:
        with connection, contextlib.suppress(OSError):
            connection.recv(65536)
            connection.sendall(fault.payload)
            match fault.ending:
                case "reset":
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                case "wait":
                    self._stopped.wait()
                case "drip":
                    while not self._stopped.wait(0.02):
                        connection.sendall(b" ")


@dataclass
class GrpcFault:
    """The answer to every call: messages of these bytes, then the status, with bytes as problem metadata."""

    messages: tuple[bytes, ...] = ()
    code: grpc.StatusCode = grpc.StatusCode.OK
    problem: bytes | None = None


class HostileGrpc(grpc.GenericRpcHandler):  # type: ignore[misc]
    """Answers `fault` to every call of any method."""

    def __init__(self) -> None:
        self.fault = GrpcFault()

    def __enter__(self) -> HostileGrpc:
        self._server = grpc.server(futures.ThreadPoolExecutor(4), handlers=[self])
        self.address = f"127.0.0.1:{self._server.add_insecure_port('127.0.0.1:0')}"
        self._server.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.stop(None).wait()

    def service(self, _: Any) -> Any:
        return grpc.unary_stream_rpc_method_handler(self._answer)

    def _answer(self, _: Any, context: grpc.ServicerContext) -> Iterator[bytes]:
        fault = self.fault
        yield from fault.messages
        if fault.problem is not None:
            context.set_trailing_metadata(((PROBLEM_METADATA_KEY, fault.problem),))
        if fault.code is not grpc.StatusCode.OK:
            context.abort(fault.code, "a fault")
