"""A gateway for tests of `pretouch gateway watch`: its messages, and a server with scripted answers."""

from __future__ import annotations

import json
import queue
import threading
from collections.abc import Iterator, Sequence
from concurrent import futures
from itertools import chain
from typing import Any

import grpc
import numpy as np
from pretouch_sensor_gateway.range_status import classify

from pretouch.errors import PROBLEM_METADATA_KEY, PretouchError, Unauthenticated, problem, wire_of
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.sensor_gateway_pb2_grpc import (
    SensorGatewayServiceServicer,
    add_SensorGatewayServiceServicer_to_server,
)
from pretouch.wire.common import array_to_proto

PORT = "/dev/serial/by-id/usb-Pretouch_Finger_0042-if00"


def device(
    name: str = "finger", state: pb.DeviceState.ValueType = pb.DEVICE_STATE_STREAMING, **fields: Any
) -> pb.Device:
    return pb.Device(name=name, port=PORT, state=state, **fields)


def status(of: pb.Device | None = None, **fields: Any) -> pb.GetStatusResponse:
    """A device in good health, with what is given changed."""
    healthy: dict[str, Any] = {
        "format": "binary",
        "identity": pb.Identity(serial="0102030405060708", firmware="fingertip 1.0", modules=6, period=1 / 30),
        "epoch": 3,
        "connections": 2,
        "rate": 29.98,
        "clock": pb.ClockStatus(synchronised=True, drift=12.3e-6, std=0.00018, round_trip=0.00092),
        "subscribers": 1,
    }
    return pb.GetStatusResponse(device=device() if of is None else of, **(healthy | fields))


def module(measurements: int = 1000, returns: int = 900, jumps: int = 0, **fields: Any) -> pb.ModuleStatus:
    return pb.ModuleStatus(measurements=measurements, returns=returns, jumps=jumps, **fields)


def ranges(
    t: Sequence[float] | np.ndarray,
    metres: object,
    codes: object = 0,
    flags: object = 0,
    *,
    epoch: int = 3,
    lost: int = 0,
    overrun: int = 0,
) -> pb.StreamRangesResponse:
    """Measurements at times t (f,); metres (f, k), codes and flags likewise or one for all. A code but 0 is a miss."""
    measured = np.atleast_2d(np.asarray(metres, dtype=np.float64))
    code = np.broadcast_to(np.asarray(codes), measured.shape)
    measured = np.where(code == 0, measured, np.nan)
    batch = pb.RangeBatch(
        t=array_to_proto(np.asarray(t, dtype=np.float64), "f8"),
        time_std=1e-4,
        sequence=array_to_proto(np.arange(len(t)), "u4"),
        epoch=epoch,
        range=array_to_proto(measured, "f8"),
        raw=array_to_proto(measured, "f8"),
        status=array_to_proto(code, "u1"),
        range_status=array_to_proto(classify(code, measured, "binary"), "u1"),
        flags=array_to_proto(np.broadcast_to(np.asarray(flags), measured.shape), "u1"),
        lost=lost,
    )
    return pb.StreamRangesResponse(batch=batch, overrun=overrun)


class FakeGateway(SensorGatewayServiceServicer):
    """A gateway on a port of 127.0.0.1, which `stop` and `start` keep.

    Args:
        token: what every call must carry.

    Attributes:
        statuses: what is said of each device, in this order.
    """

    def __init__(self, *statuses: pb.GetStatusResponse, token: str | None = None) -> None:
        self.statuses = {each.device.name: each for each in statuses}
        self._token = token
        self._listeners: dict[str, list[queue.Queue[pb.StreamRangesResponse | None]]] = {}
        self._changed = threading.Condition()
        self._port = 0
        self._server: grpc.Server | None = None

    def __enter__(self) -> FakeGateway:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self._port}"

    def start(self) -> None:
        self._server = grpc.server(futures.ThreadPoolExecutor(16), options=[("grpc.so_reuseport", 0)])
        add_SensorGatewayServiceServicer_to_server(self, self._server)
        self._port = self._server.add_insecure_port(self.address)
        self._server.start()

    def stop(self) -> None:
        if self._server is not None:
            with self._changed:
                for listener in chain.from_iterable(self._listeners.values()):
                    listener.put(None)
                self._listeners.clear()
            self._server.stop(grace=None).wait()
            self._server = None

    def send(self, name: str, response: pb.StreamRangesResponse, timeout: float = 60.0) -> None:
        """Gives `response` to all who listen to the device, once there is one."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._listeners.get(name), timeout):
                raise TimeoutError(f"Nobody listens to {name}.")
            for listener in self._listeners[name]:
                listener.put(response)

    def ListDevices(self, request: pb.ListDevicesRequest, context: grpc.ServicerContext) -> pb.ListDevicesResponse:
        self._check(context)
        return pb.ListDevicesResponse(devices=[status.device for status in self.statuses.values()])

    def GetStatus(self, request: pb.GetStatusRequest, context: grpc.ServicerContext) -> pb.GetStatusResponse:
        self._check(context)
        return self.statuses[request.device]

    def StreamRanges(
        self, request: pb.StreamRangesRequest, context: grpc.ServicerContext
    ) -> Iterator[pb.StreamRangesResponse]:
        self._check(context)
        mine: queue.Queue[pb.StreamRangesResponse | None] = queue.Queue()
        if not context.add_callback(lambda: mine.put(None)):  # the call has ended already
            return
        with self._changed:
            self._listeners.setdefault(request.device, []).append(mine)
            self._changed.notify_all()
        while (response := mine.get()) is not None:
            yield response
        with self._changed:
            if mine in self._listeners.get(request.device, []):
                self._listeners[request.device].remove(mine)

    def _check(self, context: grpc.ServicerContext) -> None:
        given = dict(context.invocation_metadata()).get("authorization")
        if self._token is not None and given != f"Bearer {self._token}":
            _refuse(context, Unauthenticated("The call carries a wrong token.", "Send the token."))


def _refuse(context: grpc.ServicerContext, error: PretouchError) -> None:
    context.set_trailing_metadata(((PROBLEM_METADATA_KEY, json.dumps(problem(error)).encode()),))
    context.abort(wire_of(error).grpc_code, error.detail)
