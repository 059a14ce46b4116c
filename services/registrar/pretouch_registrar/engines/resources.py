"""What engines share between problems: threads, and data derived from camera models."""

from __future__ import annotations

import os
import weakref
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import Any, TypeVar

from pretouch.cancellation import check_cancelled
from pretouch_registrar.engines.camera_model import CameraModel

T = TypeVar("T")
R = TypeVar("R")


def _apply(function: Callable[[T], R], item: T) -> R:
    check_cancelled()
    return function(item)


class Resources:
    """Threads and derived data; made once by the `Registrar`, and thread-safe.

    Attributes:
        threads: the number of processors that this process may run on.
    """

    def __init__(self) -> None:
        self.threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(self.threads, thread_name_prefix="registrar")
        self._derived: weakref.WeakKeyDictionary[CameraModel, dict[Callable[..., Any], Any]] = (
            weakref.WeakKeyDictionary()
        )

    def map(self, function: Callable[[T], R], items: Iterable[T]) -> list[R]:
        """`function` of each item, on all threads: kernels release Python's lock. Calls must not be nested.

        Raises:
            Cancelled: nobody waits for the result any more; items that were not begun are not.
        """
        jobs = [(copy_context(), item) for item in items]
        return list(self._pool.map(lambda job: job[0].run(_apply, function, job[1]), jobs))

    def derive_from_model(self, model: CameraModel, make: Callable[[CameraModel], R]) -> R:
        """`make(model)`, cached for as long as the model lives; `make` must be a module's function.

        Two threads may make the same one at the same time.
        """
        known = self._derived.setdefault(model, {})
        if make not in known:
            known[make] = make(model)
        result: R = known[make]
        return result
