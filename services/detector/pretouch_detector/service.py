"""Starts the detector: loads the network, warms the kernels up, and registers the servicer."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import grpc.aio

from pretouch.serving import ServiceContext
from pretouch.v1 import detector_pb2, detector_pb2_grpc
from pretouch_detector.proposals import deep, warm_up
from pretouch_detector.servicer import DetectorServicer


@asynccontextmanager
async def running(server: grpc.aio.Server, context: ServiceContext) -> AsyncIterator[tuple[str, ...]]:
    """Serves `pretouch.v1.DetectorService`."""
    await context.run_in_thread(deep.warm_up, context.settings.workers)
    await context.run_in_thread(warm_up)
    detector_pb2_grpc.add_DetectorServiceServicer_to_server(DetectorServicer(context), server)
    yield (detector_pb2.DESCRIPTOR.services_by_name["DetectorService"].full_name,)
