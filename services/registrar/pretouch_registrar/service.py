"""Starts the registrar: reads the settings, warms the kernels up, and registers the servicer."""

from __future__ import annotations

import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import grpc

from pretouch.errors import InvalidInput
from pretouch.serving import ServiceContext
from pretouch.v1 import registrar_pb2, registrar_pb2_grpc
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import CACHE_BYTES, Registrar
from pretouch_registrar.servicer import RegistrarServicer
from pretouch_registrar.warm_up import warm_up

ENGINE_VARIABLE = "PRETOUCH_REGISTRAR_ENGINE"
_SHARE_OF_CACHES = 0.3
"""Largest share of the service's memory for recent results."""


@asynccontextmanager
async def running(server: grpc.aio.Server, context: ServiceContext) -> AsyncIterator[tuple[str, ...]]:
    """Serves `pretouch.v1.RegistrarService`; PRETOUCH_REGISTRAR_ENGINE names the engine of requests that name none."""
    name = os.environ.get(ENGINE_VARIABLE) or Engine.POSTERIOR.value
    if name not in set(Engine):
        raise InvalidInput(f"{ENGINE_VARIABLE} is {name!r}.", f"Choose one of {', '.join(Engine)}.")
    registrar = Registrar(min(CACHE_BYTES, int(_SHARE_OF_CACHES * context.memory)))
    await context.run_in_thread(warm_up, registrar)
    context.set_aside(registrar.cache_bytes)
    registrar_pb2_grpc.add_RegistrarServiceServicer_to_server(
        RegistrarServicer(context, registrar, Engine(name)), server
    )
    yield (registrar_pb2.DESCRIPTOR.services_by_name["RegistrarService"].full_name,)
