"""An evaluation saves finished runs, resumes from them, and summarises the runs in its tables."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.made_runs import KEY, run_of
from pretouch_registrar.engines import Engine
from pretouch_simulation.evaluation_pool import PartialResults, keys, run_all
from pretouch_simulation.evaluation_protocol import Protocol, finger_of, request_of
from pretouch_simulation.evaluation_rows import RunKey, write_details
from pretouch_simulation.evaluation_summary import errors_after, summaries
from pretouch_simulation.evaluation_tasks import FrameTask, MeshTask
from pretouch_simulation.finger import FingerModel
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.objects import box
from pretouch_simulation.protocol import make_case

from pretouch.errors import Conflict, InvalidInput, NotFound
from pretouch.session import Planner

PROTOCOL = Protocol(3, None, Engine.POSTERIOR, Planner.INFORMATION, FingerModel.IDEAL, seed=0)


def test_a_run_has_one_finger_and_states_its_sensor() -> None:
    cases = [make_case("box", box(), view) for view in range(2)]
    protocol = replace(PROTOCOL, sensor=FingerModel.RANDOM)
    stated = [request_of(case, protocol).sensor.range_std for case in cases]
    assert stated == [finger_of(case, protocol).sensor.range_std for case in cases]
    assert stated[0] != stated[1]
    assert request_of(cases[0], replace(protocol, seed=1)).sensor.range_std != stated[0]


RUNS = [
    run_of(KEY, 0.012, 0.004, 0.002),
    run_of(KEY._replace(view=1), 0.006),
    run_of(KEY._replace(mesh="box")),
]


def test_a_stopped_run_keeps_its_last_error_and_one_without_scans_its_first() -> None:
    np.testing.assert_allclose(errors_after(RUNS, 1), [0.012, 0.006, 0.02])
    np.testing.assert_allclose(errors_after(RUNS, 3), [0.002, 0.006, 0.02])


def test_a_summary_before_the_first_scan_knows_the_error_only() -> None:
    (before,) = summaries(RUNS, (0,))
    assert (before.n, before.mean, before.large) == (3, pytest.approx(0.02), 1.0)
    assert np.isnan([before.covered, before.expected_error, before.compute_p50]).all()


def test_details_are_a_line_for_each_row(tmp_path: Path) -> None:
    write_details(tmp_path / "details.jsonl", RUNS)
    lines = [json.loads(line) for line in (tmp_path / "details.jsonl").read_text().splitlines()]
    assert [(line["mesh"], line["view"], line["scan"]) for line in lines] == [
        ("mug", 0, 1),
        ("mug", 0, 2),
        ("mug", 0, 3),
        ("mug", 1, 1),
    ]
    assert (lines[0]["camera"], "frame" in lines[0]) == ("kinect", False)
    assert lines[0]["distance2"] == 4.0
    assert len(lines[0]["whitened"]) == 6


def test_runs_that_are_kept_are_not_made_again(tmp_path: Path) -> None:
    kept = PartialResults(tmp_path / "out.json", PROTOCOL)
    frame = tmp_path / "0001.json"
    tasks = [MeshTask(tmp_path / "mug.ply", 0), FrameTask(frame, "mug", 0), FrameTask(frame, "mug", 1)]
    protocols = [replace(PROTOCOL, engine=engine) for engine in (Engine.PAPER, Engine.POSTERIOR)]
    for key in keys(tasks, protocols):
        kept.add(run_of(key, 0.01))
    runs = run_all(tasks, protocols, 1, kept, lambda run: pytest.fail("made again"))
    assert [(run.engine, run.camera, run.frame, run.view) for run in runs] == [
        (engine, *world)
        for engine in ("paper", "posterior")
        for world in [("kinect", None, 0), ("real", "0001", 0), ("real", "0001", 1)]
    ]


def test_partial_results_are_read_back_as_they_were(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out.json"
    kept = PartialResults(out, PROTOCOL)
    for run in RUNS:
        kept.add(run)
    again = PartialResults(out, PROTOCOL)
    assert list(again.runs.values()) == RUNS
    again.remove()
    assert not kept.path.exists()


def test_a_line_cut_short_is_forgotten_and_the_rest_kept(tmp_path: Path) -> None:
    kept = PartialResults(tmp_path / "out.json", PROTOCOL)
    kept.add(RUNS[0])
    whole = kept.path.read_text()
    kept.path.write_text(whole + json.dumps(RUNS[1].as_dict())[:40])
    again = PartialResults(tmp_path / "out.json", PROTOCOL)
    assert list(again.runs.values()) == RUNS[:1]
    again.add(RUNS[1])
    assert list(PartialResults(tmp_path / "out.json", PROTOCOL).runs.values()) == RUNS[:2]


def test_partial_results_of_other_settings_are_not_mixed_in(tmp_path: Path) -> None:
    PartialResults(tmp_path / "out.json", PROTOCOL).add(RUNS[0])
    with pytest.raises(Conflict, match="other settings"):
        PartialResults(tmp_path / "out.json", replace(PROTOCOL, seed=1))
    with pytest.raises(Conflict, match="other settings"):
        PartialResults(tmp_path / "out.json", replace(PROTOCOL, leader=Engine.PAPER))


def test_another_engine_is_added_to_what_is_there(tmp_path: Path) -> None:
    PartialResults(tmp_path / "out.json", PROTOCOL).add(RUNS[0])
    again = PartialResults(tmp_path / "out.json", replace(PROTOCOL, engine=Engine.PAPER, sensor=FingerModel.VL6180X))
    assert again.runs == {RunKey("mug", 0, "point_to_plane", "ideal", "kinect"): RUNS[0]}


def test_meshes_are_chosen_by_name_and_number(tmp_path: Path) -> None:
    for name in ("b.ply", "a.obj", "c.STL", "notes.txt", "index.json"):
        (tmp_path / name).touch()
    assert [path.name for path in meshes_in(tmp_path)] == ["a.obj", "b.ply", "c.STL"]
    assert [path.name for path in meshes_in(tmp_path, limit=2)] == ["a.obj", "b.ply"]
    assert [path.name for path in meshes_in(tmp_path, only=["c", "a"])] == ["a.obj", "c.STL"]


def test_a_folder_that_cannot_be_evaluated_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="no folder"):
        meshes_in(tmp_path / "missing")
    with pytest.raises(NotFound, match="no mesh"):
        meshes_in(tmp_path)
    (tmp_path / "mug.ply").touch()
    with pytest.raises(NotFound) as refused:
        meshes_in(tmp_path, only=["cup"])
    assert "mug" in refused.value.remedy
    (tmp_path / "mug.stl").touch()
    with pytest.raises(InvalidInput, match="two meshes called mug"):
        meshes_in(tmp_path)
