"""`pretouch evaluate --campaign`: its options, rows and table, and sessions that learn from those before."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from helpers.made_frame import write_mesh
from pretouch_registrar.engines import Engine
from pretouch_simulation import campaign_command
from pretouch_simulation.campaign_sessions import CampaignKey, CampaignRun, run_campaign
from pretouch_simulation.campaign_table import campaign_table, last_rows
from pretouch_simulation.campaign_world import Campaign, CampaignSettings, Change
from pretouch_simulation.evaluate_command import evaluate
from pretouch_simulation.evaluation_protocol import NEVER_CONVERGED, Protocol
from pretouch_simulation.evaluation_rows import Row
from pretouch_simulation.finger import FingerModel
from pretouch_simulation.objects import box, can

from pretouch.errors import InvalidInput
from pretouch.session import Planner, Proposer

PROTOCOL = Protocol(1, Proposer.RANDOM, Engine.POSTERIOR, Planner.CONFIDENCE, FingerModel.IDEAL, 0, NEVER_CONVERGED)
ROW = Row(
    **{"mesh": "box", "view": 1, "scan": 1, "proposer": "random", "engine": "posterior", "planner": "information"},
    **{"sensor": "ideal", "initial_error": 0.02, "error": 0.002, "expected_error": 0.002, "covered": True},
    **{"state": "converged", "fraction": 0.1, "robot_seconds": 9.0, "compute_ms": 1.0, "camera": "kinect"},
    **{"scan_seconds": 9.0, "campaign": 0, "position": 1, "knock": False, "prior_error": 0.02, "prior_covered": True},
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("meshes")
    for name, mesh in (("box", box()), ("can", can())):
        write_mesh(made / f"{name}.obj", mesh)
    return made


def campaign_of(folder: Path, objects: int = 2, **settings: Any) -> Campaign:
    return Campaign(CampaignSettings(objects, **settings), tuple(sorted(folder.iterdir())), 0, seed=0)


def told(run: CampaignRun) -> list[dict[str, Any]]:
    return [{name: value for name, value in row.as_dict().items() if name != "compute_ms"} for row in run.rows]


def test_a_session_starts_from_what_those_before_found(folder: Path) -> None:
    learned = run_campaign(campaign_of(folder), PROTOCOL, True)
    assert learned.problems == {}
    first, second = learned.rows
    assert (first.campaign, first.position, first.scan, first.knock) == (0, 1, 1, False)
    assert (second.position, second.drift) == (2, "steady")
    assert first.prior_error == first.initial_error
    assert second.prior_error is not None
    assert second.prior_error < 0.7 * second.initial_error
    again = run_campaign(campaign_of(folder, objects=1), PROTOCOL, True)
    alone = run_campaign(campaign_of(folder, objects=1), PROTOCOL, False)
    assert told(again) == told(learned)[:1]
    assert [{**row, "drift": "steady"} for row in told(alone)] == told(learned)[:1]


def test_a_session_without_a_scan_has_a_row_and_teaches_nothing(folder: Path) -> None:
    run = run_campaign(campaign_of(folder), replace(PROTOCOL, tolerance=0.2), True)
    assert [(row.position, row.scan, row.state) for row in run.rows] == [(1, 0, "converged"), (2, 0, "converged")]
    assert all(row.robot_seconds == 0 and row.prior_error == row.initial_error for row in run.rows)


def test_an_object_that_cannot_be_evaluated_does_not_end_the_campaign(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n")
    meshes = (tmp_path / "flat.obj", folder / "box.obj")
    run = run_campaign(Campaign(CampaignSettings(2), meshes, 0, 0), replace(PROTOCOL, tolerance=0.2), True)
    assert len(run.rows) == len(run.problems) == 1
    assert CampaignRun.from_dict(json.loads(json.dumps(run.as_dict()))) == run


def made_runs(*calls: Any) -> list[CampaignRun]:
    runs = []
    for learns in (True, False):
        rows = [
            replace(ROW, position=k, view=k, robot_seconds=9.0 if k == 1 or not learns else 2.0) for k in range(1, 6)
        ]
        rows.insert(0, replace(rows[0], scan=1, state="awaiting_scan", robot_seconds=4.0))
        rows[1] = replace(rows[1], scan=2)
        runs.append(CampaignRun(CampaignKey(0, learns, "posterior", "ideal", "kinect"), tuple(rows), {}))
    return runs


def test_the_table_has_a_line_for_each_position_and_for_all_that_know_the_camera() -> None:
    runs = made_runs()
    assert [row.scan for row in last_rows(runs[0].rows)] == [2, 1, 1, 1, 1]
    table = campaign_table(runs, 0.003)
    assert [line[0] for line in table.lines] == ["1", "2", "3", "4", "5", "4-5"]
    where = {name: k for k, name in enumerate(table.headings)}
    last = table.lines[-1]
    assert [last[where[name]] for name in ("n", "robot s", "alone: robot s")] == ["2", "2.0", "9.0"]


def invoke(options: list[str]) -> None:
    app = typer.Typer()
    app.command()(evaluate)
    app(options, standalone_mode=False)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--moving-camera", "--drift", "0.1", "1"], "--moving-camera, --drift cannot go without --campaign"),
        (["--campaign", "2", "--clutter", "--report", "r.html"], "--report, --clutter cannot go with --campaign"),
        (["--campaign", "2", "--knock", "3", "0.01", "2"], "--knock is at position 3"),
        (["--campaign", "2", "--residual", "-1", "2"], "out of its limits"),
    ],
)
def test_options_that_do_not_fit_campaigns_are_refused(
    options: list[str], said: str, folder: Path, tmp_path: Path
) -> None:
    with pytest.raises(InvalidInput) as refused:
        invoke(["--meshes", str(folder), "--json", str(tmp_path / "out.json"), *options])
    assert said in refused.value.detail
    assert list(tmp_path.iterdir()) == []


def test_the_command_writes_both_and_goes_on_where_it_was_interrupted(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows without `camera.id` are apart, so that a program that reads `rows` does not mix them."""
    asked = []

    def answer(function: Any, calls: list[tuple[Campaign, Protocol, bool]], *_: Any) -> Any:
        asked.append(calls)
        for (campaign, _, learns), run in zip(calls, made_runs()[-len(calls) :], strict=True):
            assert campaign.settings == CampaignSettings(5, True, knock_at=3, knock=Change(0.01, np.radians(2.0)))
            yield replace(run, key=run.key._replace(learns=learns))
            if len(asked) == 1:
                raise KeyboardInterrupt

    monkeypatch.setattr(campaign_command, "run_in_workers", answer)
    out = tmp_path / "out.json"
    options = ["--meshes", str(folder), "--campaign", "5", "--views", "1", "--moving-camera", "--json", str(out)]
    options += ["--knock", "3", "0.01", "2"]
    with pytest.raises(typer.Exit):
        evaluate_directly(options)
    assert not out.exists()
    evaluate_directly(options)
    assert [len(calls) for calls in asked] == [2, 1]
    (_, protocol, _), *_ = asked[0]
    assert (protocol.tolerance, protocol.scans, protocol.seconds, protocol.stop) == (0.003, 10, 120.0, True)
    written = json.loads(out.read_text())
    assert [len(written[name]) for name in ("rows", "rows_without_camera_id")] == [6, 6]
    assert written["rows"][-1] == {**ROW.as_dict(), "position": 5, "view": 5, "robot_seconds": 2.0}
    assert list(tmp_path.iterdir()) == [out]


def evaluate_directly(options: list[str]) -> None:
    """As `invoke`, but an exit code is raised rather than returned."""
    app = typer.Typer()
    app.command()(evaluate)
    if code := app(options, standalone_mode=False):
        raise typer.Exit(code)
