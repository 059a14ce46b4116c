"""Many tasks in worker processes of one thread each: the same numbers for any number of workers."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from typing import Any, TypeVar

from pretouch.interrupts import interrupts_held_back

Answer = TypeVar("Answer")
ONE_THREAD = {name: "1" for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
"""One thread each, so that sums are made in a fixed order."""


def run_in_workers(
    function: Callable[..., Answer],
    calls: Sequence[tuple[Any, ...]],
    workers: int,
    prepare: Callable[..., None],
    arguments: tuple[Any, ...] = (),
) -> Generator[Answer, None, None]:
    """Calls `function(*call)` for each of `calls`; yields the answers as they come. Closed early, it drops the rest.

    Args:
        function: a module's own, so that a worker can import it; so is `prepare`.
        prepare: called once in each worker, with `arguments`: compiles and loads in advance what the first call needs.

    Raises:
        KeyboardInterrupt: all calls that have not returned are dropped, at once.
    """
    if not calls:
        return
    context = multiprocessing.get_context("spawn")
    with _environment(ONE_THREAD):
        pool = ProcessPoolExecutor(
            min(workers, len(calls)), mp_context=context, initializer=_begin, initargs=(prepare, arguments)
        )
        try:
            with interrupts_held_back():  # workers never see one, not even before they can ignore it
                futures = [pool.submit(function, *call) for call in calls]
            for future in as_completed(futures):
                yield future.result()
        except (KeyboardInterrupt, GeneratorExit):
            for worker in multiprocessing.active_children():
                worker.terminate()
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _begin(prepare: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    """Ends with the parent."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    prepare(*arguments)


def _end_with(parent: Any) -> None:
    parent.join()
    os._exit(1)


@contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
