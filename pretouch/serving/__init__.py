"""What every service starts with: server, health, reflection, TLS, token, limits, metrics and logs.

A service package offers in its module `service` an async context manager

    @asynccontextmanager
    async def running(server: grpc.aio.Server, context: ServiceContext) -> AsyncIterator[tuple[str, ...]]:
        ...                      # warm up; the health service answers NOT_SERVING meanwhile
        add_XServiceServicer_to_server(servicer, server)
        yield ("pretouch.v1.XService",)
        ...                      # after the drain: close what was opened

and the command line serves it with `serve`, a test or a program that hosts it with `started`.
"""

from pretouch.serving.context import ServiceContext
from pretouch.serving.metrics import Metrics
from pretouch.serving.process import serve
from pretouch.serving.server import Running, Started, started
from pretouch.serving.settings import Settings

__all__ = ["Metrics", "Running", "ServiceContext", "Settings", "Started", "serve", "started"]
