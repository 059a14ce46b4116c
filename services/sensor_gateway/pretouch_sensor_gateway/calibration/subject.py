"""The device under calibration, as its gateway shows it: all that is needed is a synchronous gRPC stub."""

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
from pretouch_sensor_gateway.calibration.apart import answer, stream
from pretouch_sensor_gateway.calibration.model import Calibration
from pretouch_sensor_gateway.calibration.wire import calibration_to_proto
from pretouch_sensor_gateway.wire_formats.received import OK

_TIMEOUT = 10.0
"""s for one answer; what a stream needs beyond three times its expected length."""
_PATIENCE = 2.0
"""s until a device streams and has told who it is: a gateway that starts with this command needs a moment."""
_POLL = 0.1
_SLOWEST = 5.0
"""Measurements per second of a device that does not say how fast it is."""


@dataclass(frozen=True, eq=False)
class Frames:
    """f measurements of k modules: raw (f, k), m, NaN where a status was not 0; and which start of the device."""

    raw: Array
    epoch: int


class Subject:
    """One device of a running gateway.

    Args:
        stub: a `SensorGatewayServiceStub` on a synchronous channel.
        device: its name; "" is the gateway's only one.

    Attributes:
        name: what the gateway calls it.
        serial: of its board, hexadecimal; "" if it tells none.

    Raises:
        Unavailable: the gateway does not answer, or the device sends nothing.
        PretouchError: what the gateway says against it.
    """

    def __init__(self, stub: Any, device: str) -> None:
        self._stub = stub
        status = self._known(device)
        self.name: str = status.device.name
        self.serial: str = status.identity.serial
        self._rate = status.rate or (1 / status.identity.period if status.identity.period > 0 else _SLOWEST)

    def _known(self, device: str) -> pb.GetStatusResponse:
        """The device's status once it streams and, if it is one that does, has told who it is."""
        end = time.monotonic() + _PATIENCE
        request = pb.GetStatusRequest(device=device)
        while True:
            try:
                status: pb.GetStatusResponse = answer(lambda: self._stub.GetStatus(request, timeout=_TIMEOUT))
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

    def frames(self, count: int, told: Callable[[int], None]) -> Frames:
        """The next `count` measurements; `told` hears how many there are so far.

        Raises:
            Unavailable: they did not come, or not all of them.
            InvalidInput: what came makes no sense.
        """
        timeout = 3 * count / self._rate + _TIMEOUT
        request = pb.StreamRangesRequest(device=self.name)
        parts: list[Array] = []
        got = 0
        try:
            with stream(lambda: self._stub.StreamRanges(request, timeout=timeout)) as responses:
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
                    told(min(got, count))
                    if got >= count:
                        return Frames(np.concatenate(parts)[:count], response.batch.epoch)
        except grpc.RpcError as error:
            if error.code() is not grpc.StatusCode.DEADLINE_EXCEEDED:
                raise from_rpc_error(error) from error
        raise Unavailable(
            f"Only {got} of {count} measurements came within {timeout:.0f} s.", "Check the device's cable and power."
        )

    def apply(self, calibration: Calibration) -> None:
        """The gateway takes ranges by this calibration from now on.

        Raises:
            PretouchError: what the gateway says against it.
        """
        request = pb.ConfigureRequest(device=self.name, calibration=calibration_to_proto(calibration))
        try:
            answer(lambda: self._stub.Configure(request, timeout=_TIMEOUT))
        except grpc.RpcError as error:
            raise from_rpc_error(error) from error
