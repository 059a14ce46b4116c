"""A device's bytes become timed frames for its listeners, and what is missing is told."""

from __future__ import annotations

import itertools
import time

import pytest
import structlog
from pretouch_sensor_gateway.device import Device, DeviceState
from pretouch_sensor_gateway.framing import Decoder, encode
from pretouch_sensor_gateway.messages import Ping, PingReply, Ranges
from pretouch_sensor_gateway.subscription import QUEUE_FRAMES, Subscription
from pretouch_sensor_gateway.transport import LinkState


class Bench:
    """A device whose port is this object: the test says what comes, and answers pings."""

    def __init__(self) -> None:
        self.device = Device("finger", "/dev/none", structlog.get_logger())
        self.device._link.state = LinkState.OPEN
        self.device._link.write = self._written  # type: ignore[method-assign]
        self.pings: list[int] = []
        self.device.opened()

    async def _written(self, data: bytes) -> None:
        self.pings += [message.sequence for message in Decoder().feed(data) if isinstance(message, Ping)]

    async def answer(self, micros: int) -> None:
        """The device's clock stands at `micros` now."""
        await self.device._ping()
        self.device.received(encode(PingReply(self.pings[-1], micros)), time.monotonic())

    def measure(self, sequence: int, micros: int) -> None:
        self.device.received(encode(Ranges(sequence, micros, (0.03,), (0,))), time.monotonic())


def taken(subscription: Subscription) -> tuple[list[int], int]:
    frames, lost = subscription.take()
    return [frame.sequence for frame in frames], lost


async def test_frames_wait_for_the_clock_and_then_come_with_their_time() -> None:
    bench = Bench()
    with bench.device.subscribed() as subscription:
        bench.measure(0, 1_000_000)
        assert taken(subscription) == ([], 0)
        before = time.time()
        await bench.answer(1_020_000)
        after = time.time()
        frames, lost = subscription.take()
        assert (len(frames), lost) == (1, 0)
        assert before - 0.021 <= frames[0].t <= after - 0.019


async def test_gaps_in_the_sequence_are_told_also_across_its_wrap() -> None:
    bench = Bench()
    await bench.answer(0)
    with bench.device.subscribed() as subscription:
        for k, sequence in enumerate([2**32 - 3, 2**32 - 1, 2]):
            bench.measure(sequence, 100 * k)
        assert taken(subscription) == ([2**32 - 3, 2**32 - 1, 2], 3)
    assert bench.device.status().lost_frames == 3


async def test_a_slow_listener_loses_the_oldest_and_is_told_a_quick_one_loses_nothing() -> None:
    bench = Bench()
    await bench.answer(0)
    with bench.device.subscribed() as slow, bench.device.subscribed() as quick:
        for sequence in range(QUEUE_FRAMES + 10):
            bench.measure(sequence, sequence)
            assert taken(quick) == ([sequence], 0)
        assert taken(slow) == (list(range(10, QUEUE_FRAMES + 10)), 10)
        assert taken(slow) == ([], 0)


async def test_a_restarted_device_gets_a_new_clock_and_no_false_losses() -> None:
    bench = Bench()
    await bench.answer(2_000_000_000)
    with bench.device.subscribed() as subscription:
        bench.measure(500, 2_000_000_000)
        bench.measure(0, 10_000)  # started anew: its clock is unknown until the next answer
        assert taken(subscription) == ([500], 0)
        bench.measure(1, 43_000)
        before = time.time()
        await bench.answer(50_000)
        frames, lost = subscription.take()
        assert ([frame.sequence for frame in frames], lost) == ([0, 1], 0)
        assert frames[0].t == pytest.approx(before - 0.040, abs=0.02)


async def test_a_ping_reply_alone_reveals_a_restart() -> None:
    bench = Bench()
    await bench.answer(2_000_000_000)
    bench.measure(5, 2_000_000_000)
    await bench.answer(1_000)
    with bench.device.subscribed() as subscription:
        bench.measure(0, 2_000)
        frames, _ = subscription.take()
        assert frames[0].t == pytest.approx(time.time(), abs=0.5)


async def test_answers_to_no_question_are_ignored() -> None:
    bench = Bench()
    bench.device.received(encode(PingReply(12345, 0)) + encode(Ping(1)), time.monotonic())
    bench.measure(0, 0)
    with bench.device.subscribed() as subscription:
        assert taken(subscription) == ([], 0)


async def test_a_device_that_answers_no_ping_loses_its_frames_and_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = itertools.count(100.0, 0.01)
    monkeypatch.setattr(time, "monotonic", lambda: next(clock))
    bench = Bench()
    with bench.device.subscribed() as subscription:
        for sequence in range(300):
            bench.measure(sequence, sequence * 10_000)
        status = bench.device.status()
        assert status.state is DeviceState.STREAMING
        assert "pings" in status.problem
        assert taken(subscription) == ([], 300 - 256)


async def test_garbage_is_counted_and_a_device_that_sends_only_that_is_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    bench = Bench()
    assert bench.device.status().state is DeviceState.CONNECTING
    now += 2.0
    assert "nothing comes" in bench.device.status().problem
    bench.device.received(b"Boot v1.2\r\n\x00hello\x00", now)
    status = bench.device.status()
    assert (status.state, status.frames, status.bad_frames) == (DeviceState.SILENT, 0, 2)
    assert "refused" in status.problem
