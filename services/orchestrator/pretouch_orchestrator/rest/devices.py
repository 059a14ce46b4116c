"""The routes of devices: what robots need of the sensor gateway that speak no gRPC."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import suppress

from fastapi import FastAPI, Request
from fastapi.responses import JSONResponse, Response, StreamingResponse

from pretouch.errors import PretouchError, Unavailable, problem
from pretouch.serving import ServiceContext
from pretouch_orchestrator.rest import device_models as models
from pretouch_orchestrator.rest import examples, openapi
from pretouch_orchestrator.rest.parameters import ClockOffset, DeviceName
from pretouch_orchestrator.rest.tip_poses import MEDIA_TYPES, check_media_type, read_tip_poses
from pretouch_orchestrator.upstream.devices import Devices

HEARTBEAT = 15.0
"""s without a range after which a comment is sent on a stream of ranges."""


def add_device_routes(app: FastAPI, devices: Devices | None, context: ServiceContext) -> None:
    """Adds the routes to `app`; without `devices` they are answered with 503."""

    def gateway() -> Devices:
        if devices is None:
            raise Unavailable(
                "This orchestrator has no sensor gateway.", "Start it with PRETOUCH_ORCHESTRATOR_GATEWAY=host:port."
            )
        return devices

    @app.get(
        "/v1/devices",
        summary="List devices",
        responses=openapi.describe_responses(
            200, openapi.describe_json(models.DeviceList, "The devices."), *(401, 503, 504)
        ),
    )
    async def list_devices() -> Response:
        """Lists the fingertips that the sensor gateway was started with, and what is wrong with each."""
        return JSONResponse({"devices": [models.device_to_json(device) for device in await gateway().list()]})

    @app.get(
        "/v1/devices/{name}",
        summary="Get a device",
        responses=openapi.describe_responses(
            200, openapi.describe_json(models.DeviceStatus, "The device."), *(401, 404, 503, 504)
        ),
    )
    async def get_device(name: DeviceName) -> Response:
        """Returns a device's state, its last ranges, and the present by the clock of its measurements."""
        return JSONResponse(models.status_to_json(await gateway().status(name)))

    @app.post(
        "/v1/devices/{name}/poses",
        summary="Send tip poses while the robot moves",
        responses=openapi.describe_responses(
            200,
            openapi.describe_json(models.PosesReport, "The last pose's ranges have been fused."),
            *(400, 401, 404, 413, 415, 422, 429, 503),
        ),
        openapi_extra=openapi.describe_lines_body(models.TipPose, MEDIA_TYPES[0]),
    )
    async def send_poses(request: Request, name: DeviceName, clock_offset: ClockOffset = None) -> Response:
        """Takes tip poses with times, one on each line, for as long as the robot moves.

        With them the ranges of the same time become samples: submit the scan as `{"gateway": {"device", "from",
        "to"}}`, with times by the clock of the gateway's host. Send ten poses a second or more, each when it is known;
        or all poses of a planned motion at once. The answer comes once the last pose's ranges have been fused. What is
        wrong with a pose ends the request at once; what came before it counts, unless the clocks differ.
        """
        check_media_type(request)
        report = await gateway().send_poses(name, clock_offset, read_tip_poses(request))
        return JSONResponse(models.report_to_json(report))

    event_stream = openapi.describe_text(
        "text/event-stream", "Server-sent events; their data is JSON.", examples.RANGES
    )

    @app.get(
        "/v1/devices/{name}/ranges",
        response_class=StreamingResponse,
        summary="Stream a device's ranges",
        responses=openapi.describe_responses(200, event_stream, 401, 404, 503, 504),
    )
    async def stream_ranges(name: DeviceName) -> Response:
        """Streams events `ranges`: times `t` (s), ranges (m, null: none) by measurement and module, and their status.

        `range_status` says what became of each range, `status` is the sensor's own code (0: good), `flags` is the sum
        of 1 (it jumped, and no later range confirms it) and 2 (the device is warming up). `lost` measurements never
        reached the gateway, `overrun` were dropped because this client reads slowly. An event `error` with a problem
        document ends the stream where the gateway fails.
        """
        await gateway().status(name)
        return StreamingResponse(
            _stream_ranges(gateway(), name, context),
            media_type="text/event-stream",
            headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
        )


async def _stream_ranges(devices: Devices, name: str, context: ServiceContext) -> AsyncIterator[str]:
    batches = devices.ranges(name)
    draining = asyncio.ensure_future(context.draining.wait())
    following = asyncio.ensure_future(anext(batches, None))
    try:
        while not draining.done():
            await asyncio.wait((following, draining), timeout=HEARTBEAT, return_when=asyncio.FIRST_COMPLETED)
            if not following.done():
                yield ": still here\n\n"
                continue
            batch = following.result()
            if batch is None:
                return
            yield f"event: ranges\ndata: {json.dumps(models.ranges_to_json(batch))}\n\n"
            following = asyncio.ensure_future(anext(batches, None))
    except PretouchError as error:
        yield f"event: error\ndata: {json.dumps(problem(error))}\n\n"
    finally:
        draining.cancel()
        following.cancel()
        with suppress(asyncio.CancelledError, Exception):
            await following
        await batches.aclose()
