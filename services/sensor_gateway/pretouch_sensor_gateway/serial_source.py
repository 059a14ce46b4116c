"""A device on a port: bytes that are read go into the pipeline, and what the pipeline wants to send is written."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Callable

import structlog

from pretouch_sensor_gateway.calibration.model import Calibration
from pretouch_sensor_gateway.measurement_pipeline import MeasurementPipeline
from pretouch_sensor_gateway.range_batch import RangeBatch
from pretouch_sensor_gateway.recent_input import RecentInput
from pretouch_sensor_gateway.source import DeviceState, SourceStatus
from pretouch_sensor_gateway.stuck_ranges import StuckRanges
from pretouch_sensor_gateway.transport.reconnection import Link, LinkState
from pretouch_sensor_gateway.wire_formats.diagnosis import explain
from pretouch_sensor_gateway.wire_formats.parser import Parser, Refusal

SILENT_AFTER = 1.0
"""Seconds without a good frame after which an open port counts as silent."""
_EXPLAINED_FOR = 2.0
"""Seconds for which an explanation of the silence is kept."""
_SAME_MOMENT = 1e-4
"""Seconds within which both clocks must be read to be compared; on a host that is too busy they are read again."""
_BITS_PER_BYTE = 10
"""On a UART with a start and a stop bit."""


class SerialSource:
    """A `Source` that reads a port.

    Args:
        deliver: gets each batch, on the event loop.
        record_event: gets what a person should know of the port, as a sentence.
        baud: bits a second of a real UART; USB and sockets ignore it.
        latency: as in `DeviceSetting`.
    """

    def __init__(
        self,
        address: str,
        parser: Parser,
        baud: int,
        latency: float | None,
        calibration: Calibration | None,
        deliver: Callable[[RangeBatch], None],
        record_event: Callable[[str], None],
        log: structlog.typing.FilteringBoundLogger,
    ) -> None:
        self._log = log
        self._link = Link(address, self, log, baud)
        self._pipeline = MeasurementPipeline(parser, _BITS_PER_BYTE / baud, calibration, latency)
        self._parser = parser
        self._baud = baud
        self._recent = RecentInput()
        self._stuck = StuckRanges()
        self._explanation, self._explained_at = "", -float("inf")
        self._deliver = deliver
        self._record_event = record_event
        self._send_due = asyncio.Event()
        self._opened_at = -float("inf")
        self._refused_before: Counter[Refusal] = Counter()  # the last good frame, or the opening

    async def run(self) -> None:
        """Reads the port and sends pings, until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._link.run())
            tasks.create_task(self._send())

    def calibrate(self, calibration: Calibration | None) -> None:
        self._pipeline.calibrate(calibration)

    def now(self) -> float:
        return time.time()

    def status(self) -> SourceStatus:
        now = time.monotonic()
        pipeline = self._pipeline
        return SourceStatus(
            state=self._state(now),
            problem=self._problem(now),
            format=pipeline.format_name,
            unit=self._parser.unit,
            recent_lines=tuple(self._recent.lines()),
            identity=pipeline.identity,
            epoch=pipeline.epoch,
            connections=self._link.connections,
            measurements=pipeline.measurements,
            refused=pipeline.refused,
            lost=pipeline.lost,
            untimed=pipeline.untimed,
            clock=pipeline.clock,
        )

    def on_opened(self, at: float) -> None:
        self._opened_at = at
        self._refused_before = self._pipeline.refused
        self._recent.clear()
        self._explained_at = -float("inf")
        self._record_event("The port was opened.")
        self._pipeline.on_port_opened(at)
        self._send_due.set()

    def on_closed(self, at: float) -> None:
        self._record_event(f"The port was lost: {self._link.problem}")
        self._pipeline.on_port_closed()

    def on_received(self, data: bytes, at: float) -> None:
        epoch = self._pipeline.epoch
        self._recent.add(data, at)
        for batch in self._pipeline.feed(data, at, _unix_time(at)):
            self._stuck.add(batch)
            self._deliver(batch)
        if self._pipeline.last_accepted == at:
            self._refused_before = self._pipeline.refused
        if self._pipeline.epoch != epoch:
            self._log.info("the device restarted", epoch=self._pipeline.epoch)
            self._record_event(f"The device restarted: epoch {self._pipeline.epoch}.")
        if self._pipeline.next_send <= at:
            self._send_due.set()

    async def _send(self) -> None:
        """Sends what the pipeline wants to send, whenever it is due."""
        while True:
            self._send_due.clear()
            if self._link.state is LinkState.OPEN:
                self._link.write(self._pipeline.take_outgoing(time.monotonic()))
                wait = self._pipeline.next_send - time.monotonic()
            else:
                wait = float("inf")
            try:
                async with asyncio.timeout(None if wait == float("inf") else max(0.0, wait)):
                    await self._send_due.wait()
            except TimeoutError:
                continue

    def _state(self, now: float) -> DeviceState:
        if self._link.state is not LinkState.OPEN:
            return DeviceState.CONNECTING
        if now - self._pipeline.last_accepted <= SILENT_AFTER:
            return DeviceState.STREAMING
        return DeviceState.CONNECTING if now - self._opened_at <= SILENT_AFTER else DeviceState.SILENT

    def _problem(self, now: float) -> str:
        if self._link.state is not LinkState.OPEN:
            return self._link.problem
        if now - max(self._pipeline.last_accepted, self._opened_at) > SILENT_AFTER:
            return self._explain_silence(now)
        if now - self._opened_at <= SILENT_AFTER:
            return ""
        return self._pipeline.problem() or self._parser.problem or self._stuck.problem()

    def _explain_silence(self, now: float) -> str:
        """Why no measurements come; told anew every few seconds, for it takes a while to find out."""
        if now - self._explained_at > _EXPLAINED_FOR:
            refused = (self._pipeline.refused - self._refused_before).most_common(1)
            self._explanation = explain(
                self._recent.last(), self._parser, refused[0][0] if refused else None, self._baud
            )
            if self._recent.last() and now - self._recent.received_at > SILENT_AFTER:
                stopped = f"The port is open, but nothing has arrived for {now - self._recent.received_at:.0f} s."
                self._explanation = f"{stopped} Before: {self._explanation}" if refused else stopped
            self._explained_at = now
        return self._explanation


def _unix_time(at: float) -> float:
    """Unix time at the recent host time `at`, s."""
    while True:
        before, unix, after = time.monotonic(), time.time(), time.monotonic()
        if after - before < _SAME_MOMENT:
            return unix - ((before + after) / 2 - at)
