"""Runs in worker processes, saved as they finish so that an interrupted evaluation can be resumed."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

from pretouch.results import STANDARD_OUTPUT
from pretouch_simulation.evaluation import key_of, run_task, warm_up
from pretouch_simulation.evaluation_protocol import Protocol
from pretouch_simulation.evaluation_rows import Run, RunKey
from pretouch_simulation.evaluation_tasks import Task
from pretouch_simulation.partial_rows import PartialRows
from pretouch_simulation.workers import run_in_workers

_VARIED = ("engine", "sensor", "camera")
"""Members in which the protocols of one evaluation may differ."""


class PartialResults:
    """Finished runs, one JSON line each, beside the file that the evaluation will write.

    Runs of other engines, sensors and cameras may be added to those of an earlier evaluation.

    Args:
        out: the file that the evaluation will write; beside standard output or a device nothing is kept.
        option: of the command line, that names it.

    Raises:
        Conflict: the file was left by an evaluation with other settings.
    """

    def __init__(self, out: Path, protocol: Protocol, option: str = "--json") -> None:
        settings = {name: value for name, value in asdict(protocol).items() if name not in _VARIED}
        streamed = out == STANDARD_OUTPUT or (out.exists() and not out.is_file())
        path = None if streamed else out.with_name(out.name + ".partial")
        self._kept = PartialRows(path, {"protocol": settings}, option)
        self.runs: dict[RunKey, Run] = {run.key: run for run in map(Run.from_dict, self._kept.rows)}

    @property
    def path(self) -> Path | None:
        return self._kept.path

    def add(self, run: Run) -> None:
        self.runs[run.key] = run
        self._kept.add(run.as_dict())

    def remove(self) -> None:
        self._kept.remove()


def keys(tasks: Sequence[Task], protocols: Sequence[Protocol]) -> list[RunKey]:
    """`Run.key` of every run, in order: as the protocols are, then as the tasks are."""
    return [key_of(task, protocol) for protocol in protocols for task in tasks]


def run_all(
    tasks: Sequence[Task],
    protocols: Sequence[Protocol],
    workers: int,
    kept: PartialResults,
    done: Callable[[Run], None],
) -> list[Run]:
    """Runs every task by every protocol that is not in `kept` yet, calling `done` after each; in the order of `keys`.

    Args:
        protocols: they differ in engine, sensor and camera only.

    Raises:
        KeyboardInterrupt: what was done by then is in `kept`.
    """
    for run in _run_missing(tasks, protocols, workers, kept.runs):
        kept.add(run)
        done(run)
    return [kept.runs[key] for key in keys(tasks, protocols)]


def _run_missing(
    tasks: Sequence[Task], protocols: Sequence[Protocol], workers: int, known: Container[RunKey]
) -> Iterator[Run]:
    missing = [
        (task, [p for p, key in zip(protocols, keys([task], protocols), strict=True) if key not in known])
        for task in tasks
    ]
    calls = [(task, wanted) for task, wanted in missing if wanted]
    for runs in run_in_workers(run_task, calls, workers, warm_up, (protocols,)):
        yield from runs
