"""An evaluation with a progress bar at a terminal."""

from __future__ import annotations

import os
from collections.abc import Sequence

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from pretouch_simulation.evaluation_pool import PartialResults, keys, run_all
from pretouch_simulation.evaluation_protocol import Protocol
from pretouch_simulation.evaluation_rows import Run
from pretouch_simulation.evaluation_tasks import Task


def run_with_progress(
    tasks: Sequence[Task],
    protocols: Sequence[Protocol],
    workers: int | None,
    kept: PartialResults,
    console: Console,
    title: str = "runs",
) -> list[Run]:
    """As `run_all`, with a bar on `console`; `workers` None: a process for each core."""
    wanted = keys(tasks, protocols)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=console) as progress:
        bar = progress.add_task(title, total=len(wanted), completed=sum(key in kept.runs for key in wanted))
        return run_all(tasks, protocols, workers or os.cpu_count() or 1, kept, lambda run: progress.advance(bar))
