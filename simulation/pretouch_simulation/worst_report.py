"""The worst runs of an evaluation as reports, beside the truth."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pretouch_orchestrator.report.document import build_document
from pretouch_orchestrator.report.page import render_page
from pretouch_orchestrator.sessions.events import derive_events
from pretouch_registrar.registration import Registrar

from pretouch.results import write_file
from pretouch_simulation.evaluation import key_of, open_session, run_steps
from pretouch_simulation.evaluation_protocol import Protocol, finger_of, loop_of
from pretouch_simulation.evaluation_rows import Run
from pretouch_simulation.evaluation_tasks import Task
from pretouch_simulation.protocol import Case
from pretouch_simulation.report import with_truth
from pretouch_simulation.worst import diagnose, worst_runs

WORST = 5
"""Runs that a report shows."""


def save_worst_runs(
    runs: Sequence[Run], tasks: Sequence[Task], protocols: Sequence[Protocol], about: str, path: Path
) -> None:
    """Writes one file of the reports of the runs with the largest errors in the end, the worst first.

    They are run once more for it, which gives the same rows. `about` is a sentence on the evaluation.
    """
    made = {key_of(task, protocol): (task, protocol) for task in tasks for protocol in protocols}
    documents = []
    for place, run in enumerate(worst_runs(runs, max(protocol.scans for protocol in protocols), WORST), start=1):
        task, protocol = made[run.key]
        case = task.case(protocol.seed, protocol.camera)
        where = f"{run.mesh}, view {run.view}" if run.frame is None else f"{run.mesh} in {run.frame}, seed {run.view}"
        title = f"{place}. {where}: {1000 * run.rows[-1].error:.1f} mm of error"
        documents.append(
            (f"{title} (engine {run.engine}, camera {run.camera}, finger {run.sensor})", _describe(case, protocol))
        )
    write_file(path, render_page("pretouch evaluate: the worst runs", about, documents).encode())


def _describe(case: Case, protocol: Protocol) -> dict[str, Any]:
    """The report's document of the protocol's run on `case`, repeated."""
    led = replace(protocol, engine=protocol.leader or protocol.engine)
    opened = asyncio.run(open_session(case, led, loop_of(led, Registrar()), finger_of(case, protocol)))
    records = [opened, *(step.record for step in run_steps(case, protocol, protocol.scans))]
    sessions = [record.to_session() for record in records]
    events = [
        event
        for before, after in zip([None, *sessions], sessions, strict=False)
        for event in derive_events(before, after)
    ]
    errors = [case.error(record.estimate.base_T_correction) for record in records]
    document = with_truth(build_document(records[-1], events), case, errors)
    cause = diagnose(case, records[-1], protocol.engine).reason
    return document | {
        "created": "in simulation",
        "outcome": f"{document['outcome']} Likely cause of the true error, {1000 * errors[-1]:.1f} mm: {cause}.",
    }
