"""Client of the gateway for the device under calibration, on a synchronous gRPC stub."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import grpc
import numpy as np

from pretouch.errors import InvalidInput, Unavailable, from_rpc_error
from pretouch.geometry import Array
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import array_from_proto
from pretouch_sensor_gateway.calibration.model import Calibration
from pretouch_sensor_gateway.calibration.proto_conversion import calibration_to_proto
from pretouch_sensor_gateway.calibration.threaded_calls import call_in_thread, stream_in_thread
from pretouch_sensor_gateway.wire_formats.parser import OK

_TIMEOUT = 10.0
"""s for one response; for a stream, in addition to three times its expected duration."""
_PATIENCE = 2.0
"""s until a device streams and has identified itself: a gateway started with this command needs a moment."""
_POLL = 0.1
_SLOWEST = 5.0
"""Measurements per second, assumed of a device that does not report its rate."""


@dataclass(frozen=True, eq=False)
class RawReadings:
    """f measurements of k modules: raw (f, k), m, NaN where a status was not 0; and the number of the boot session."""

    raw: Array
    epoch: int


class DeviceClient:
    """One device of a running gateway.

    Args:
        stub: a `SensorGatewayServiceStub` on a synchronous channel.
        device: its name; "" is the gateway's only one.

    Attributes:
        name: what the gateway calls it.
        serial: of its board, hexadecimal; "" if it has none.
        rate: measurements a second.

    Raises:
        Unavailable: the gateway does not answer, or the device sends nothing.
        PretouchError: the gateway refuses the request.
    """

    def __init__(self, stub: Any, device: str) -> None:
        self._stub = stub
        status = self._wait_until_streaming(device)
        self.name: str = status.device.name
        self.serial: str = status.identity.serial
        self.rate = status.rate or (1 / status.identity.period if status.identity.period > 0 else _SLOWEST)

    def _wait_until_streaming(self, device: str) -> pb.GetStatusResponse:
        """The device's status once it streams and, if its format allows that, has identified itself."""
        end = time.monotonic() + _PATIENCE
        request = pb.GetStatusRequest(device=device)
        while True:
            try:
                status: pb.GetStatusResponse = call_in_thread(lambda: self._stub.GetStatus(request, timeout=_TIMEOUT))
            except grpc.RpcError as error:
                raise from_rpc_error(error) from error
            streams = status.device.state == pb.DEVICE_STATE_STREAMING
            if streams and status.identity.modules:
                return status
            if time.monotonic() > end:
                break
            time.sleep(_POLL)
        if streams:
            return status
        problem = f": {status.device.problem}" if status.device.problem else "."
        raise Unavailable(
            f"The device {status.device.name} sends no ranges{problem}",
            "Check its cable and power; ListDevices tells more.",
        )

    def read(self, count: int, on_progress: Callable[[int], None]) -> RawReadings:
        """Reads the next `count` measurements; `on_progress` gets how many there are so far.

        Raises:
            Unavailable: not all of them came.
            InvalidInput: the gateway sent something inconsistent.
        """
        timeout = 3 * count / self.rate + _TIMEOUT
        request = pb.StreamRangesRequest(device=self.name)
        parts: list[Array] = []
        got = 0
        try:
            with stream_in_thread(lambda: self._stub.StreamRanges(request, timeout=timeout)) as responses:
                for response in responses:
                    raw, status = (
                        array_from_proto(getattr(response.batch, name), f"batch.{name}") for name in ("raw", "status")
                    )
                    if raw.ndim != 2 or raw.shape != status.shape:
                        raise InvalidInput(
                            f"The gateway sent {list(raw.shape)} readings and {list(status.shape)} status codes.",
                            "Use a gateway of this version of pretouch.",
                        )
                    if parts and raw.shape[1] != parts[0].shape[1]:
                        raise Unavailable(
                            f"The device has {raw.shape[1]} modules now, {parts[0].shape[1]} before.",
                            "Check that no other one was plugged in.",
                        )
                    parts.append(np.where(status == OK, raw, np.nan))
                    got += len(raw)
                    on_progress(min(got, count))
                    if got >= count:
                        return RawReadings(np.concatenate(parts)[:count], response.batch.epoch)
        except grpc.RpcError as error:
            if error.code() is not grpc.StatusCode.DEADLINE_EXCEEDED:
                raise from_rpc_error(error) from error
        raise Unavailable(
            f"Only {got} of {count} measurements came within {timeout:.0f} s.", "Check the device's cable and power."
        )

    def apply(self, calibration: Calibration) -> None:
        """Makes the gateway use this calibration from now on.

        Raises:
            PretouchError: the gateway refuses the request.
        """
        request = pb.ConfigureRequest(device=self.name, calibration=calibration_to_proto(calibration))
        try:
            call_in_thread(lambda: self._stub.Configure(request, timeout=_TIMEOUT))
        except grpc.RpcError as error:
            raise from_rpc_error(error) from error
