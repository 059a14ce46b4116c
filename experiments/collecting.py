"""Runs one-scan jobs in worker processes, with an estimate of the time; finished rows survive an interruption."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import Any

from pretouch_detector.proposals import list_readiness
from pretouch_simulation.partial_rows import PartialRows
from pretouch_simulation.workers import run_in_workers
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from experiments.one_scan import ALGORITHM_1, CANDIDATES, PAPER, Job, Row, prepare, run_job
from pretouch.errors import Unavailable
from pretouch.session import Proposer

PROPOSERS = (Proposer.RANDOM, Proposer.NARF, Proposer.STABILITY, Proposer.DEEP)
_SECONDS = {"ideal": 0.18, PAPER: 0.015}
_WIDE_BEAM_SECONDS = 0.35
"""s of one core for one scan and its registration, of other fingers."""
_VIEW_SECONDS, _LABELLED_VIEW_SECONDS = 1.0, 12.0


def split_by_readiness(wanted: Iterable[Proposer]) -> tuple[list[Proposer], dict[str, str]]:
    """Splits the proposers into those that are ready, and the reasons why the others are not.

    Raises:
        Unavailable: none can.
    """
    reasons = dict(list_readiness())
    wanted = list(wanted)
    missing = {proposer.value: reasons[proposer] for proposer in wanted if reasons[proposer]}
    usable = [proposer for proposer in wanted if not reasons[proposer]]
    if not usable:
        raise Unavailable(f"None of the proposers is ready: {'; '.join(missing.values())}", "Name another one.")
    return usable, missing


def run_jobs(jobs: Sequence[Job], workers: int | None, kept: PartialRows, title: str) -> list[Row]:
    """Runs the jobs whose rows are not in `kept` yet; the rows of all jobs, in their order.

    Raises:
        KeyboardInterrupt: what was made by then is in `kept`.
    """
    rows = {row.key: row for row in map(Row.from_dict, kept.rows)}
    missing = [job for job in jobs if job.key not in rows]
    processes = workers or os.cpu_count() or 1
    console = Console(stderr=True)
    costs = {job.key: _cost(job) for job in jobs}
    seconds = sum(costs[job.key] for job in missing) / processes
    console.print(f"{title}: {len(missing)} of {len(jobs)} jobs to do, about {seconds:.0f} s in {processes} processes")
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(elapsed_when_finished=True), console=console) as progress:
        bar = progress.add_task(
            title, total=sum(costs.values()), completed=int(sum(costs.get(key, 0.0) for key in rows))
        )
        setups = tuple(dict.fromkeys(job.setup for job in missing))
        for row in run_in_workers(run_job, [(job,) for job in missing], processes, prepare, (setups,)):
            kept.add(row.as_dict())
            rows[row.key] = row
            progress.advance(bar, costs[row.key])
    for row in rows.values():
        if row.problem:
            console.print(f"{row.target}, {row.setup}, {row.subject}: {row.problem}")
    return [rows[job.key] for job in jobs]


def jobs_of(
    target: Any, setup: str, proposers: Sequence[Proposer], offsets: int, seed: int, first: int, candidates: int
) -> list[Job]:
    """A job for each proposer's `first` rectangles, after one for `candidates` random ones, if any."""
    subjects = [(CANDIDATES, candidates)] if candidates else []
    subjects += [(proposer.value, first) for proposer in proposers]
    return [Job(target, setup, subject, count, offsets, seed) for subject, count in subjects]


def _cost(job: Job) -> float:
    """s of one core."""
    view = _LABELLED_VIEW_SECONDS if job.subject == ALGORITHM_1 else _VIEW_SECONDS
    return view + job.count * job.offsets * _SECONDS.get(job.setup, _WIDE_BEAM_SECONDS)
