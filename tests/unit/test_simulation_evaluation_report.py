"""The worst runs of an evaluation as reports: the same runs once more, the worst first, beside the truth."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import trimesh
from pretouch_registrar.engines import Engine
from pretouch_simulation.evaluation import run_task
from pretouch_simulation.evaluation_protocol import Protocol
from pretouch_simulation.evaluation_tasks import mesh_tasks
from pretouch_simulation.finger import FingerModel
from pretouch_simulation.worst_report import save_worst_runs

from pretouch.session import Planner, Proposer

PAPER = Protocol(2, Proposer.RANDOM, Engine.PAPER, Planner.CONFIDENCE, FingerModel.IDEAL, seed=0)


def test_the_reports_are_of_the_rows_and_show_the_true_error(tmp_path: Path) -> None:
    box = tmp_path / "a<b>box.ply"
    trimesh.creation.box((0.08, 0.06, 0.05)).export(box)
    tasks = mesh_tasks([box], range(2))
    runs = [run for task in tasks for run in run_task(task, [PAPER])]
    save_worst_runs(runs, tasks, [PAPER], "Two <views>.", tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "a<b>" not in page
    assert "Two &lt;views&gt;" in page
    documents = [json.loads(each) for each in re.findall(r'<script type="application/json">(.*?)</script>', page)]
    runs.sort(key=lambda run: -run.rows[-1].error)
    assert len(documents) == len(runs)
    for run, document in zip(runs, documents, strict=True):
        errors = [run.initial_error, *(row.error for row in run.rows)]
        assert document["truth"]["errors"] == pytest.approx(errors, abs=1e-12)
        expected = [each["expected_error"] for each in document["estimates"]]
        assert expected[1:] == pytest.approx([row.expected_error for row in run.rows], abs=1e-12)
        assert "Likely cause of the true error" in document["outcome"]
        assert document["created"] == "in simulation"
