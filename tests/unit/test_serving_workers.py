"""Threads and memory of a service: in order, bounded, given back, and free soon after nobody waits any more."""

from __future__ import annotations

import asyncio
import threading

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from pretouch.cancellation import check_cancelled
from pretouch.errors import Overloaded, TooLarge
from pretouch.serving.memory import MemoryBudget
from pretouch.serving.workers import Workers


def workers(threads: int = 1, queue: int = 8, memory: int = 100) -> tuple[Workers, MemoryBudget]:
    budget = MemoryBudget(memory)
    return Workers(threads, queue, budget), budget


async def test_a_running_job_ends_at_its_next_look_when_nobody_waits_and_frees_thread_and_memory() -> None:
    pool, budget = workers()
    started, ended = threading.Event(), threading.Event()

    def endless() -> None:
        started.set()
        try:
            while True:
                check_cancelled()
        finally:
            ended.set()

    job = asyncio.create_task(pool.run(endless, memory=60))
    await asyncio.to_thread(started.wait, 30)
    waiting = asyncio.create_task(pool.run(int, memory=60))
    await asyncio.sleep(0)
    assert budget.used == 60
    job.cancel()
    assert await asyncio.wait_for(waiting, 30) == 0
    assert ended.is_set()
    await asyncio.sleep(0.01)
    assert budget.used == 0
    pool.close()


async def test_a_waiting_job_that_nobody_waits_for_is_never_started() -> None:
    pool, budget = workers()
    gate, ran = threading.Event(), []
    first = asyncio.create_task(pool.run(gate.wait, 30))
    second = asyncio.create_task(pool.run(ran.append, 1))
    third = asyncio.create_task(pool.run(ran.append, 2))
    await asyncio.sleep(0.01)
    assert pool.waiting == 2
    second.cancel()
    gate.set()
    await asyncio.gather(first, third)
    assert ran == [2]
    assert (pool.waiting, budget.used) == (0, 0)
    pool.close()


async def test_a_full_queue_refuses_with_the_time_to_wait_but_nothing_that_is_half_done() -> None:
    pool, _ = workers(queue=1)
    gate = threading.Event()
    jobs = [asyncio.create_task(pool.run(gate.wait, 30)) for _ in range(2)]
    await asyncio.sleep(0.01)
    with pytest.raises(Overloaded) as caught:
        await pool.run(int)
    assert caught.value.retry_after
    assert caught.value.retry_after >= 1
    jobs.append(asyncio.create_task(pool.run(gate.wait, 30, begun=True)))
    await asyncio.sleep(0.01)
    gate.set()
    await asyncio.gather(*jobs)
    pool.close()


async def test_running_out_of_memory_is_overload_and_never_a_defect() -> None:
    pool, budget = workers()
    with pytest.raises(Overloaded, match="memory"):
        await pool.run(bytes, 1 << 62)
    with pytest.raises(TooLarge) as caught:
        await pool.run(int, memory=101)
    assert "PRETOUCH_MEMORY" in caught.value.remedy
    assert await pool.run(int) == 0
    assert budget.used == 0
    pool.close()


async def test_memory_is_given_in_order_and_only_for_so_long() -> None:
    budget = MemoryBudget(10)
    async with budget.reserve(8) as held:
        with pytest.raises(Overloaded):
            async with budget.reserve(5, patience=0.01):
                pass
        large = asyncio.create_task(budget.take(9))
        small = asyncio.create_task(budget.take(1))
        await asyncio.sleep(0)
        held.shrink(1)
        await large
        assert budget.used == 10
        assert not small.done()
    await small
    assert budget.used == 10


class Budget(RuleBasedStateMachine):
    """However reservations come, wait, give up and go: never more than the limit is used, and all comes back."""

    def __init__(self) -> None:
        super().__init__()
        self.loop = asyncio.new_event_loop()
        self.budget = MemoryBudget(10)
        self.tasks: list[tuple[int, asyncio.Task[None]]] = []

    def turn(self) -> None:
        self.loop.run_until_complete(asyncio.sleep(0))
        self.loop.run_until_complete(asyncio.sleep(0))

    @rule(size=st.integers(0, 10))
    def ask(self, size: int) -> None:
        self.tasks.append((size, self.loop.create_task(self.budget.take(size))))
        self.turn()

    @precondition(lambda self: self.tasks)
    @rule(data=st.data())
    def leave(self, data: st.DataObject) -> None:
        size, task = self.tasks.pop(data.draw(st.integers(0, len(self.tasks) - 1)))
        if task.done():
            self.budget.give_back(size)
        else:
            task.cancel()
        self.turn()

    @precondition(lambda self: self.tasks)
    @rule(data=st.data())
    def leave_as_the_turn_comes(self, data: st.DataObject) -> None:
        held = [entry for entry in self.tasks if entry[1].done()]
        waiting = [entry for entry in self.tasks if not entry[1].done()]
        if held and waiting:
            self.tasks.remove(held[0])
            self.budget.give_back(held[0][0])
            gone = data.draw(st.sampled_from(waiting))
            self.tasks.remove(gone)
            gone[1].cancel()
        self.turn()

    @invariant()
    def sums_up(self) -> None:
        assert self.budget.used == sum(size for size, task in self.tasks if task.done()) <= 10
        waiting = [size for size, task in self.tasks if not task.done()]
        assert not waiting or self.budget.used + waiting[0] > 10

    def teardown(self) -> None:
        for _, task in self.tasks:
            task.cancel()
        self.turn()
        self.loop.close()


TestBudget = Budget.TestCase
TestBudget.settings = settings(max_examples=40, stateful_step_count=20, deadline=None)
