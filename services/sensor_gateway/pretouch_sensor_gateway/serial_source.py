"""A device on a port: what the link hears goes through the intake, what the intake wants to say goes out."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Callable

import structlog

from pretouch_sensor_gateway.batch import Batch
from pretouch_sensor_gateway.calibration.model import Calibration
from pretouch_sensor_gateway.intake import Intake
from pretouch_sensor_gateway.source import DeviceState, SourceStatus
from pretouch_sensor_gateway.transport.link import Link, LinkState
from pretouch_sensor_gateway.wire_formats.received import Refusal, WireFormat

SILENT_AFTER = 1.0
"""Seconds without a good frame after which an open port counts as silent."""
_SAME_MOMENT = 1e-4
"""Seconds within which both clocks must be read to be compared; on a host that is too busy they are read again."""
_BITS_PER_BYTE = 10
"""On a UART with a start and a stop bit."""


class SerialSource:
    """A `Source` that reads a port.

    Args:
        deliver: gets each batch, on the event loop.
        happened: is told what a person should know of the line, as a sentence.
        baud: bits a second of a real UART; USB and sockets ignore it.
    """

    def __init__(
        self,
        address: str,
        wire_format: WireFormat,
        baud: int,
        calibration: Calibration | None,
        deliver: Callable[[Batch], None],
        happened: Callable[[str], None],
        log: structlog.typing.FilteringBoundLogger,
    ) -> None:
        self._log = log
        self._link = Link(address, self, log, baud)
        self._intake = Intake(wire_format, _BITS_PER_BYTE / baud, calibration)
        self._deliver = deliver
        self._happened = happened
        self._talk = asyncio.Event()
        self._opened_at = -float("inf")
        self._refused_before: Counter[Refusal] = Counter()  # the last good frame, or the opening

    async def run(self) -> None:
        """Reads the port and answers for the handshake, until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._link.run())
            tasks.create_task(self._keep_talking())

    def calibrate(self, calibration: Calibration | None) -> None:
        self._intake.calibrate(calibration)

    def now(self) -> float:
        return time.time()

    def status(self) -> SourceStatus:
        now = time.monotonic()
        intake = self._intake
        return SourceStatus(
            state=self._state(now),
            problem=self._problem(now),
            format=intake.format_name,
            identity=intake.identity,
            epoch=intake.epoch,
            connections=self._link.connections,
            frames=intake.frames,
            refused=intake.refused,
            lost=intake.lost,
            untimed=intake.untimed,
            clock=intake.clock,
        )

    def opened(self, at: float) -> None:
        self._opened_at = at
        self._refused_before = self._intake.refused
        self._happened("The port was opened.")
        self._intake.opened(at)
        self._talk.set()

    def closed(self, at: float) -> None:
        self._happened(f"The port was lost: {self._link.problem}")
        self._intake.closed()

    def received(self, data: bytes, at: float) -> None:
        epoch = self._intake.epoch
        for batch in self._intake.received(data, at, _unix_time(at)):
            self._deliver(batch)
        if self._intake.last_good == at:
            self._refused_before = self._intake.refused
        if self._intake.epoch != epoch:
            self._log.info("the device started anew", epoch=self._intake.epoch)
            self._happened(f"The device started anew: epoch {self._intake.epoch}.")
        if self._intake.next_send <= at:
            self._talk.set()

    async def _keep_talking(self) -> None:
        while True:
            self._talk.clear()
            if self._link.state is LinkState.OPEN:
                self._link.write(self._intake.outgoing(time.monotonic()))
                wait = self._intake.next_send - time.monotonic()
            else:
                wait = float("inf")
            try:
                async with asyncio.timeout(None if wait == float("inf") else max(0.0, wait)):
                    await self._talk.wait()
            except TimeoutError:
                continue

    def _state(self, now: float) -> DeviceState:
        if self._link.state is not LinkState.OPEN:
            return DeviceState.CONNECTING
        if now - self._intake.last_good <= SILENT_AFTER:
            return DeviceState.STREAMING
        return DeviceState.CONNECTING if now - self._opened_at <= SILENT_AFTER else DeviceState.SILENT

    def _problem(self, now: float) -> str:
        if self._link.state is not LinkState.OPEN:
            return self._link.problem
        if now - max(self._intake.last_good, self._opened_at) > SILENT_AFTER:
            refused = (self._intake.refused - self._refused_before).most_common(1)
            if not refused:
                return "The port is open but nothing comes that ends a frame."
            return f"The port is open but no good frame comes; most were refused because: {refused[0][0].value}."
        return self._intake.problem() if now - self._opened_at > SILENT_AFTER else ""


def _unix_time(at: float) -> float:
    """Seconds since the Unix epoch at the recent host time `at`, s."""
    while True:
        before, unix, after = time.monotonic(), time.time(), time.monotonic()
        if after - before < _SAME_MOMENT:
            return unix - ((before + after) / 2 - at)
