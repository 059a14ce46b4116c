"""The fingertips that the sensor gateway serves, for robots that speak no gRPC."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Sequence
from contextlib import aclosing
from dataclasses import dataclass

from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch_orchestrator.upstream.copies import Copies

_QUICK = 10.0
"""s: deadline of a lookup."""
_WAITING = 4
"""Pieces of a body that wait for the gateway, before no more is read."""


@dataclass
class PoseReport:
    """What became of tip poses that were sent.

    Attributes:
        poses: how many were sent.
        out_of_order: of these, dropped because one of a later time had come before.
        samples: ranges that were fused with them.
        unposed: measurements dropped because no two poses close enough in time enclose them.
    """

    poses: int = 0
    out_of_order: int = 0
    samples: int = 0
    unposed: int = 0


class Devices:
    """Calls the gateway about its devices. All methods raise what the gateway raised, and `Unavailable` without one."""

    def __init__(self, gateway: Copies) -> None:
        self._gateway = gateway

    async def list(self) -> Sequence[pb.Device]:
        answer = await self._gateway.call("ListDevices", pb.ListDevicesRequest(), _QUICK)
        return list(answer.devices)

    async def status(self, name: str) -> pb.GetStatusResponse:
        answer: pb.GetStatusResponse = await self._gateway.call("GetStatus", pb.GetStatusRequest(device=name), _QUICK)
        return answer

    def ranges(self, name: str) -> AsyncGenerator[pb.StreamRangesResponse]:
        """A device's ranges as they arrive, until it is closed or the gateway ends."""
        return self._gateway.stream("StreamRanges", pb.StreamRangesRequest(device=name))

    async def send_poses(
        self, name: str, clock_offset: float | None, poses: AsyncIterator[Sequence[pb.TipPose]]
    ) -> PoseReport:
        """Sends tip poses as they come, until the last one's samples have been fused.

        Args:
            clock_offset: the clock of the poses' times minus the gateway's, s; None: they are the same.

        Raises:
            PretouchError: what `poses` raised, or the gateway: then at once, though more poses may come.
        """
        await self.status(name)  # before anything is sent: it says so if there is no such device
        report = PoseReport()
        waiting: asyncio.Queue[Sequence[pb.TipPose] | None] = asyncio.Queue(_WAITING)

        async def read() -> None:
            async for tips in poses:
                await waiting.put(tips)
            await waiting.put(None)

        async def tell() -> AsyncGenerator[pb.StreamPointsRequest]:
            yield pb.StreamPointsRequest(device=name, clock_offset=clock_offset)
            while (tips := await waiting.get()) is not None:
                report.poses += len(tips)
                yield pb.StreamPointsRequest(tip_poses=tips)

        async def listen() -> None:
            async with aclosing(self._gateway.stream("StreamPoints", tell())) as answers:
                async for answer in answers:
                    report.out_of_order += answer.out_of_order
                    report.unposed += answer.unposed
                    report.samples += sum(answer.samples.t.shape)

        tasks = reading, listening = asyncio.ensure_future(read()), asyncio.ensure_future(listen())
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            if not listening.done():
                reading.result()
            await listening
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        return report
