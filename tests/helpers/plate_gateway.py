"""A gateway whose finger looks at a plate: a real gRPC server, known modules, and a plate at any distance.

with PlateGateway(ModuleCalibration(0.003), None) as gateway:      # None: a module that sees nothing
    gateway.plate = 0.02                                           # m, and `slide` m a frame while it is read
    ...                                                            # gateway.address
    gateway.calls, gateway.configured                              # what was asked for
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator
from typing import Any

import grpc.aio
import numpy as np
from pretouch_sensor_gateway.calibration.model import ModuleCalibration

from pretouch.geometry import Array
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.sensor_gateway_pb2_grpc import (
    SensorGatewayServiceServicer,
    add_SensorGatewayServiceServicer_to_server,
)
from pretouch.wire.common import array_to_proto

SERIAL = "0102030405060708"
BATCH = 7


class PlateGateway(SensorGatewayServiceServicer):
    """One device `left`, or another name that the test gives.

    Attributes:
        plate: m from the finger; slide: m that it moves with each frame.
        state: what the device is in, and problem: what is wrong with it.
        epoch: of the device's frames.
        outliers: share of readings that are far off, with a good status.
        silent: the streams stay open and send nothing.
        cut: frames after which a stream breaks off; None: none does.
        rate: of the measurements, as the gateway reports it.
        streaming: set while a stream is read.
    """

    def __init__(self, *modules: ModuleCalibration | None, device: str = "left") -> None:
        self.modules = modules
        self.device = device
        self.plate, self.slide, self.outliers = 0.05, 0.0, 0.0
        self.state: pb.DeviceState.ValueType = pb.DEVICE_STATE_STREAMING
        self.problem, self.epoch = "", 1
        self.rate = 300.0
        self.silent = False
        self.cut: int | None = None
        self.streaming = threading.Event()
        self.configured: list[pb.ConfigureRequest] = []
        self.asked: list[str] = []
        self._rng = np.random.default_rng(0)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)

    def __enter__(self) -> PlateGateway:
        self._thread.start()
        self.address = f"127.0.0.1:{self._run(self._start())}"
        return self

    def __exit__(self, *_: object) -> None:
        self._run(self._server.stop(0))
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(10)
        self._loop.close()

    async def GetStatus(self, request: pb.GetStatusRequest, context: Any) -> pb.GetStatusResponse:
        self.asked.append(request.device)
        if request.device not in ("", self.device):
            await context.abort(grpc.StatusCode.NOT_FOUND, f"There is no device {request.device!r}.")
        return pb.GetStatusResponse(
            device=pb.Device(name=self.device, state=self.state, problem=self.problem),
            identity=pb.Identity(serial=SERIAL, modules=len(self.modules), period=1 / 30),
            rate=self.rate,
        )

    async def StreamRanges(
        self, request: pb.StreamRangesRequest, context: Any
    ) -> AsyncIterator[pb.StreamRangesResponse]:
        assert request.device == self.device
        await context.send_initial_metadata(())
        self.streaming.set()
        try:
            sent = 0
            if self.silent:
                await asyncio.Event().wait()
            while True:
                yield pb.StreamRangesResponse(batch=self._batch(sent))
                sent += BATCH
                if self.cut is not None and sent >= self.cut:
                    await context.abort(grpc.StatusCode.UNAVAILABLE, "The gateway is shutting down.")
                await asyncio.sleep(0.001)
        finally:
            self.streaming.clear()

    async def Configure(self, request: pb.ConfigureRequest, context: Any) -> pb.ConfigureResponse:
        self.configured.append(request)
        return pb.ConfigureResponse()

    def _batch(self, sent: int) -> pb.RangeBatch:
        plate: Array = self.plate + self.slide * (sent + np.arange(BATCH, dtype=np.float64))
        raw, status = np.full((BATCH, len(self.modules)), np.nan), np.full((BATCH, len(self.modules)), 7)
        for k, module in enumerate(self.modules):
            if module is None:
                continue
            noise = self._rng.standard_normal(BATCH) * module.std_at(plate) / module.gain(plate)
            raw[:, k] = np.round(module.predict_reading(plate) + noise, 3)
            raw[self._rng.uniform(size=BATCH) < self.outliers, k] = 0.2
            status[:, k] = 0
        lost = self._rng.uniform(size=status.shape) < 0.05
        raw[lost], status[lost] = 0.0, 6  # the range beside a bad status has no meaning
        return pb.RangeBatch(
            t=array_to_proto(np.arange(BATCH), "f8"),
            sequence=array_to_proto(sent + np.arange(BATCH), "u4"),
            epoch=self.epoch,
            range=array_to_proto(np.full_like(raw, 0.077), "f8"),  # calibrated already, and not what is wanted
            raw=array_to_proto(raw, "f8"),
            status=array_to_proto(status, "u1"),
            flags=array_to_proto(np.full_like(status, 2), "u1"),
        )

    async def _start(self) -> int:
        self._server = grpc.aio.server()
        add_SensorGatewayServiceServicer_to_server(self, self._server)
        port = self._server.add_insecure_port("127.0.0.1:0")
        await self._server.start()
        return int(port)

    def _run(self, coroutine: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result(30)
