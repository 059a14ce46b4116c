"""The same work on a Ray cluster."""

from __future__ import annotations

import importlib
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from types import ModuleType
from typing import Any, TypeVar

from pretouch.errors import Unavailable
from pretouch_simulation.workers import ONE_THREAD

Answer = TypeVar("Answer")


def run_on_ray(function: Callable[..., Answer], calls: Sequence[tuple[Any, ...]], workers: int) -> Iterator[Answer]:
    """Calls `function(*call)` for each of `calls`, with one core and one thread each; yields the answers as they come.

    The cluster is the one that RAY_ADDRESS names, else a temporary one of `workers` processes on this machine.
    A call whose node fails is repeated on another one.

    Raises:
        Unavailable: Ray is not installed, or the cluster does not answer.
    """
    if not calls:
        return
    ray = _ray()
    address = os.environ.get("RAY_ADDRESS")
    options: dict[str, Any] = {"address": address} if address else {"num_cpus": workers, "address": "local"}
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    at_end = signal.getsignal(signal.SIGTERM)
    try:
        ray.init(
            **options,
            include_dashboard=None if address else False,
            log_to_driver=False,
            logging_level="error",
            runtime_env={"env_vars": ONE_THREAD},
        )
    except Exception as error:  # Ray raises the base class if a node does not start in time
        raise Unavailable(
            f"Ray cannot be used: {str(error).strip()}", "Check RAY_ADDRESS, or leave out --engine-cluster."
        ) from error
    signal.signal(signal.SIGTERM, at_end)  # Ray sets one that ends the process at once
    try:
        remote = ray.remote(num_cpus=1)(function)
        waiting = [remote.remote(*call) for call in calls]
        while waiting:
            ready, waiting = ray.wait(waiting)
            try:
                yield ray.get(ready[0])
            except ray.exceptions.RayError as error:
                raise Unavailable(
                    f"The Ray cluster gave up a view: {error}", "Start the same command again: it goes on."
                ) from error
    finally:
        ray.shutdown()


def _ray() -> ModuleType:
    try:
        return importlib.import_module("ray")
    except ImportError as error:
        raise Unavailable("Ray is not installed.", "Run: pip install 'pretouch[ray]'") from error
