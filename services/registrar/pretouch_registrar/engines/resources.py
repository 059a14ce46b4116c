"""What engines share from one problem to the next: threads, and what was worked out from a camera model."""

from __future__ import annotations

import os
import weakref
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from pretouch_registrar.engines.camera_model import CameraModel

T = TypeVar("T")
R = TypeVar("R")


class Resources:
    """Made once, by the `Registrar`, and shared between threads.

    Attributes:
        threads: as many as there are processors to run on.
    """

    def __init__(self) -> None:
        self.threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(self.threads, thread_name_prefix="registrar")
        self._kept: weakref.WeakKeyDictionary[CameraModel, dict[Callable[..., Any], Any]] = weakref.WeakKeyDictionary()

    def map(self, function: Callable[[T], R], items: Iterable[T]) -> list[R]:
        """`function` of each item, on all threads: the kernels run without Python's lock. Not from within another."""
        return list(self._pool.map(function, items))

    def of_model(self, model: CameraModel, make: Callable[[CameraModel], R]) -> R:
        """What `make`, a function of a module, makes of the model, kept for as long as the model lives.

        Two threads may make the same at the same time.
        """
        known = self._kept.setdefault(model, {})
        if make not in known:
            known[make] = make(model)
        result: R = known[make]
        return result
