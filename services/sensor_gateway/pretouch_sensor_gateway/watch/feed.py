"""Feeds a gateway's messages into the state, over gRPC, and reconnects after every outage."""

from __future__ import annotations

import asyncio
import re
import time
from typing import Any, NoReturn

import grpc
import grpc.aio

from pretouch.backoff import Backoff
from pretouch.errors import (
    PROBLEM_METADATA_KEY,
    InvalidInput,
    MethodNotAllowed,
    NotFound,
    PretouchError,
    Unauthenticated,
    from_rpc_error,
)
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch_sensor_gateway.watch.state import Watch, WatchedDevice

STATUS_PERIOD = 0.5
"""Seconds between two queries of a device's status, which also notice that the gateway is gone."""
TIMEOUT = 3.0
"""Seconds to wait for a response."""
FIRST_DELAY, MAX_DELAY = 0.5, 5.0
"""Seconds before a gateway is tried again; doubled each time."""
_LASTING = (InvalidInput, MethodNotAllowed, NotFound, Unauthenticated)
"""Errors that a retry does not fix."""


class Feed:
    """Feeds a gateway's messages into `watch`.

    Args:
        stub: a `SensorGatewayServiceStub` on a channel of asyncio.
        device: the name of the only device to watch; "" for all.
    """

    def __init__(self, stub: Any, watch: Watch, device: str) -> None:
        self._stub = stub
        self._watch = watch
        self._device = device

    async def run(self) -> NoReturn:
        """Runs until cancelled; waits for a gateway that goes away.

        Raises:
            PretouchError: an error that a retry does not fix: a wrong token, no such device, no gateway there.
        """
        backoff = Backoff(FIRST_DELAY, MAX_DELAY)
        while True:
            errors: list[Exception] = []
            try:
                await self._follow_all()
            except* (grpc.RpcError, PretouchError) as group:
                errors += group.exceptions
            if self._watch.connected:
                backoff.reset()
            problem = self._describe(errors[0])
            now, delay = time.monotonic(), backoff.next_delay()
            self._watch.take_failure(problem, now + delay, now)
            await asyncio.sleep(delay)

    async def _follow_all(self) -> None:
        """Follows all devices until something fails."""
        while not (devices := await self._list_devices()):
            self._watch.take_devices([], time.monotonic())
            await asyncio.sleep(STATUS_PERIOD)
        self._watch.take_devices(devices, time.monotonic())
        async with asyncio.TaskGroup() as tasks:
            for device in self._watch.devices:
                tasks.create_task(self._follow_status(device))
                tasks.create_task(self._follow_ranges(device))

    async def _list_devices(self) -> list[pb.Device]:
        """Queries the devices to watch.

        Raises:
            NotFound: the gateway does not have the one to watch.
        """
        devices: list[pb.Device] = list(
            (await self._stub.ListDevices(pb.ListDevicesRequest(), timeout=TIMEOUT)).devices
        )
        if not self._device:
            return devices
        chosen = [device for device in devices if device.name == self._device]
        if not chosen:
            names = ", ".join(device.name for device in devices) or "none"
            raise NotFound(f"The gateway has no device {self._device!r}.", f"Its devices are: {names}.")
        return chosen

    async def _follow_status(self, device: WatchedDevice) -> NoReturn:
        while True:
            status = await self._stub.GetStatus(pb.GetStatusRequest(device=device.name), timeout=TIMEOUT)
            device.take_status(status, time.monotonic())
            self._watch.changes += 1
            await asyncio.sleep(STATUS_PERIOD)

    async def _follow_ranges(self, device: WatchedDevice) -> NoReturn:
        while True:
            async for response in self._stub.StreamRanges(pb.StreamRangesRequest(device=device.name)):
                device.take_ranges(response)
                self._watch.changes += 1
            await asyncio.sleep(STATUS_PERIOD)  # a stream has no regular end; open another, whatever ended it

    def _describe(self, error: Exception) -> str:
        """Describes the error, if a retry may fix it.

        Raises:
            PretouchError: a retry does not fix it.
        """
        if not isinstance(error, grpc.RpcError):
            raise error
        problem = from_rpc_error(error)
        address = self._watch.address
        if isinstance(problem, MethodNotAllowed):
            raise InvalidInput(
                f"What answers at {address} is no sensor gateway.", "Give the gateway's host:port, as 127.0.0.1:50053."
            ) from error
        if isinstance(problem, _LASTING):
            raise problem from error
        if any(key == PROBLEM_METADATA_KEY for key, _ in error.trailing_metadata() or ()):
            return f"The gateway at {address} refuses: {problem.detail}"
        if error.code() is grpc.StatusCode.DEADLINE_EXCEEDED:
            return f"The gateway at {address} did not answer within {TIMEOUT:g} s."
        return f"No gateway answers at {address}: {_reason(problem.detail)}."


def _reason(detail: str) -> str:
    """The reason in gRPC's text for a failed connection, without its preamble."""
    return re.sub(r".*last error: \w+: (?:\S+: )?", "", detail).rstrip(".")
