"""Simulates a finger on a bad line: every 20 s something goes wrong, in simulated time that runs as fast as it can.

What the boards sent must be what was delivered plus what was reported lost.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from pretouch_sensor_gateway.measurement_pipeline import MeasurementPipeline
from pretouch_sensor_gateway.range_batch import RangeBatch
from pretouch_sensor_gateway.subscription_queue import SubscriptionQueue
from pretouch_sensor_gateway.wire_formats.binary import BinaryParser

from benchmarks.virtual_finger import VirtualFinger, flip_bits

EVERY = 20.0
"""Seconds from fault to fault."""
STEP = 0.01
"""Seconds in which everything that happens is read at once."""


@dataclass
class Listener:
    """A subscriber with its own times of reading, and what it received."""

    subscription: SubscriptionQueue = field(default_factory=SubscriptionQueue)
    reads_again: float = 0.0
    got: int = 0
    lost: int = 0
    overrun: int = 0

    def read(self, now: float) -> None:
        if now < self.reads_again:
            return
        batches, overrun = self.subscription.take()
        self.overrun += overrun
        self.got += sum(len(batch) for batch in batches)
        self.lost += sum(batch.lost for batch in batches)


class Hour:
    """The line, the boards on it, the gateway's side, and who listens.

    Attributes:
        sent: measurements that boards made while they were the gateway's to hear.
        worst_time_error: s, of any delivered measurement.
        faults: how often each went wrong.
    """

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.now = 0.0
        self.unix = 1.7e9
        self.pipeline = MeasurementPipeline(BinaryParser(), 0.0, None)
        self.board = VirtualFinger(boot=1, first_tick=2**32 - 600_000_000)  # wraps after ten minutes
        self.boots = 1
        self.sent = self.delivered = 0
        self.worst_time_error = 0.0
        self.time_errors: list[float] = []
        self.faults: Counter[str] = Counter()
        self.quick, self.slow = Listener(), Listener()
        self._unplugged_until = self._silent_until = self._flips_until = self._mute_until = 0.0
        self._swap_back: tuple[float, VirtualFinger] | None = None
        self._cut_next = 0
        self._plugged = True
        self._starts = {1: 0.0}
        self.pipeline.on_port_opened(0.0)

    def run(self, seconds: float) -> None:
        """Passes the time; the last second is without faults, so that every gap is followed by a frame."""
        kinds: list[Callable[[], None]] = [
            self.unplug, self.reboot, self.flip, self.garbage, self.endless, self.half_frames, self.stall,
            self.another_board, self.host_jump, self.no_replies, self.repeat, self.stop_reading,
        ]  # fmt: skip
        end, next_fault = self.now + seconds, self.now + EVERY / 2
        order: list[int] = []
        while self.now < end:
            self.now += STEP
            if self.now >= next_fault and self.now < end - EVERY / 2:
                order = order or self.rng.permutation(len(kinds)).tolist()
                fault = kinds[order.pop()]
                self.faults[fault.__name__] += 1
                fault()
                next_fault += EVERY
            self._pass_step()
        self.slow.reads_again = 0.0
        self.slow.read(self.now)

    def unplug(self) -> None:
        """Unplugged within a frame; the board keeps its power and goes on measuring."""
        frame = self._measure()
        self._hear(frame[: self.rng.integers(1, len(frame))])
        self._unplugged_until = self.now + self.rng.uniform(0.05, 3.0)

    def reboot(self) -> None:
        self.boots += 1
        self.board = self._new_board(self.boots, self.now + self.rng.uniform(0.1, 2.0))

    def flip(self) -> None:
        self._flips_until = self.now + 2.0

    def garbage(self) -> None:
        self._hear(self.rng.bytes(int(self.rng.integers(1, 4000))))

    def endless(self) -> None:
        self._hear(self.rng.integers(1, 256, 20_000).astype(np.uint8).tobytes())

    def half_frames(self) -> None:
        self._cut_next = 10

    def stall(self) -> None:
        """The board hangs: it does not measure."""
        pause = self.rng.uniform(0.5, 4.0)
        self.board.pause(pause)
        self._silent_until = self.now + pause

    def another_board(self) -> None:
        """Another board is on the port for five seconds; the first one keeps running."""
        self._swap_back = (self.now + 5.0, self.board)
        self._replug()
        self.boots += 1
        self.board = self._new_board(self.boots, self.now - 100.0, serial="00000000000000bb")
        self.board.skip_to(self.now)

    def host_jump(self) -> None:
        self.unix += float(self.rng.choice([-3600.0, 3600.0, -0.5, 30.0]))

    def no_replies(self) -> None:
        self._mute_until = self.now + 8.0

    def repeat(self) -> None:
        frame = self._measure()
        self._hear(frame + frame)

    def stop_reading(self) -> None:
        self.slow.reads_again = self.now + 15.0

    def _pass_step(self) -> None:
        if self._swap_back and self.now >= self._swap_back[0]:
            self.board, self._swap_back = self._swap_back[1], None
            self._replug()
            self.board.skip_to(self.now)
        if self.now >= self._unplugged_until and not self._plugged:
            self._plugged = True
            self.pipeline.on_port_opened(self.now)
        elif self.now < self._unplugged_until and self._plugged:
            self._plugged = False
            self.pipeline.on_port_closed()
        if self._plugged and self.pipeline.next_send <= self.now:
            replies = self.board.answers(self.pipeline.take_outgoing(self.now), self.now)
            self.now += float(self.rng.lognormal(np.log(0.001), 0.5))
            if self.now >= max(self._mute_until, self._silent_until, self.board.start):
                self._hear(replies)
        while self.board.next_due <= self.now:
            frame = self._measure()
            if self._cut_next:
                self._cut_next -= 1
                frame = frame[: len(frame) // 2] + b"\0"
            self._hear(frame)
        self.quick.read(self.now)
        self.slow.read(self.now)

    def _measure(self) -> bytes:
        self.sent += 1
        return self.board.measure()

    def _hear(self, data: bytes) -> None:
        if not self._plugged:
            return
        if self.now < self._flips_until:
            data = flip_bits(data, 0.01, self.rng)
        for batch in self.pipeline.feed(data, self.now, self.unix + self.now):
            self._on_delivered(batch)

    def _on_delivered(self, batch: RangeBatch) -> None:
        self.delivered += len(batch)
        true = self.unix + self.board.time_of(batch.sequence.astype(np.float64))
        error = np.abs(batch.t - true).max()
        self.worst_time_error = max(self.worst_time_error, float(error))
        for listener in (self.quick, self.slow):
            listener.subscription.put(batch)

    def _replug(self) -> None:
        self.pipeline.on_port_closed()
        self.pipeline.on_port_opened(self.now)

    def _new_board(self, boot: int, start: float, serial: str = "00000000000000aa") -> VirtualFinger:
        tick, drift = int(self.rng.integers(2**32)), float(self.rng.uniform(-50e-6, 50e-6))
        return VirtualFinger(boot=boot, start=start, first_tick=tick, drift=drift, serial=serial)

    @property
    def reported(self) -> int:
        """Measurements that the gateway said to have lost."""
        return self.pipeline.lost + self.pipeline.untimed
