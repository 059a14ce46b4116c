"""How many steps of sessions are under way at once, and which are refused before any work for them."""

from __future__ import annotations

import asyncio

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pretouch_orchestrator.sessions.step_queue import PATIENCE, StepQueue

from pretouch.errors import Overloaded


class Steps:
    """Steps that wait in a queue or are under way until they are told to end."""

    def __init__(self, limit: int) -> None:
        self.queue = StepQueue(limit)
        self.under_way: list[int] = []
        self.most = 0
        self.begun: list[int] = []
        self.ends: dict[int, asyncio.Event] = {}
        self.tasks: dict[int, asyncio.Task[None]] = {}

    async def start(self, number: int) -> None:
        self.ends[number] = asyncio.Event()
        self.tasks[number] = asyncio.create_task(self._step(number))
        await asyncio.sleep(0)

    async def end(self, number: int) -> None:
        self.ends[number].set()
        await asyncio.wait([self.tasks[number]])
        await asyncio.sleep(0)

    async def _step(self, number: int) -> None:
        async with self.queue.turn():
            self.begun.append(number)
            self.under_way.append(number)
            self.most = max(self.most, len(self.under_way))
            try:
                await self.ends[number].wait()
            finally:
                self.under_way.remove(number)


async def test_steps_take_turns_in_the_order_of_asking() -> None:
    steps = Steps(2)
    for number in range(5):
        await steps.start(number)
    assert (steps.under_way, steps.queue.waiting) == ([0, 1], 3)
    await steps.end(1)
    assert (steps.under_way, steps.queue.waiting) == ([0, 2], 2)
    steps.tasks[3].cancel()  # its client has gone
    await steps.end(0)
    assert (steps.under_way, steps.queue.waiting) == ([2, 4], 0)


async def test_a_step_that_would_wait_for_long_is_refused_with_the_time_that_it_would_take() -> None:
    steps = Steps(1)
    for number in range(int(PATIENCE) + 1):
        await steps.start(number)  # a step is first thought to take a second
    with pytest.raises(Overloaded, match="steps of sessions are under way") as refused:
        steps.queue.check()
    assert refused.value.retry_after == PATIENCE + 1
    with pytest.raises(Overloaded):
        async with steps.queue.turn():
            pass
    await steps.end(0)
    steps.queue.check()


@given(limit=st.integers(1, 4), order=st.lists(st.tuples(st.integers(0, 7), st.booleans()), max_size=40))
def test_never_more_than_the_limit_and_no_turn_is_lost(limit: int, order: list[tuple[int, bool]]) -> None:
    async def run() -> None:
        steps = Steps(limit)
        for number in range(8):
            await steps.start(number)
        for number, cancelled in order:
            if cancelled:
                steps.tasks[number].cancel()
                await asyncio.wait([steps.tasks[number]])
                await asyncio.sleep(0)
            elif number in steps.under_way:
                await steps.end(number)
            left = sum(not task.done() for task in steps.tasks.values())
            assert len(steps.under_way) == min(limit, left)
        for number in range(8):
            steps.ends[number].set()
        await asyncio.wait(steps.tasks.values())
        assert steps.most == limit
        assert (steps.queue.waiting, steps.under_way) == (0, [])

    asyncio.run(run())
