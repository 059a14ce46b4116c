"""An evaluation keeps what is done, goes on from there, and says in its tables what the runs came to."""

import json
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from pretouch_registrar.engines import Engine
from pretouch_simulation.evaluation import Protocol
from pretouch_simulation.evaluation_pool import PartialResults, keys, run_all
from pretouch_simulation.evaluation_rows import Detail, Row, Run, write_details
from pretouch_simulation.evaluation_summary import errors_after, summaries
from pretouch_simulation.evaluation_table import by_engine, by_object, by_scan
from pretouch_simulation.finger import FingerModel
from pretouch_simulation.mesh_folder import meshes_in
from rich.console import Console
from rich.table import Table

from pretouch.errors import Conflict, InvalidInput, NotFound
from pretouch.session import Planner

PROTOCOL = Protocol(3, None, Engine.POSTERIOR, Planner.INFORMATION, FingerModel.IDEAL, seed=0)


def detail_of(distance2: float) -> Detail:
    return Detail((0.1,) * 6, (0.5,) * 6, distance2, 0.008, "translation along the vertical of the table", 90, 60)


def run_of(mesh: str, view: int, *errors: float, initial: float = 0.02, engine: str = "point_to_plane") -> Run:
    rows = [
        Row(
            mesh,
            view,
            k + 1,
            "random",
            engine,
            "information",
            "ideal",
            initial,
            error,
            0.004,
            k > 0,
            0.1 * (k + 1),
            8.0 * (k + 1),
            50.0,
        )
        for k, error in enumerate(errors)
    ]
    return Run(mesh, view, engine, "ideal", initial, tuple(rows), tuple(detail_of(4.0) for _ in rows))


RUNS = [run_of("mug", 0, 0.012, 0.004, 0.002), run_of("mug", 1, 0.006), run_of("box", 0)]


def text_of(table: Table) -> list[list[str]]:
    console = Console(file=StringIO(), width=200)
    console.print(table)
    lines = str(console.file.getvalue()).splitlines()  # type: ignore[attr-defined]
    return [[cell.strip() for cell in line.strip("│").split("│")] for line in lines if line.startswith("│")]


def test_a_stopped_run_keeps_its_last_error_and_one_without_scans_its_first() -> None:
    np.testing.assert_allclose(errors_after(RUNS, 1), [0.012, 0.006, 0.02])
    np.testing.assert_allclose(errors_after(RUNS, 3), [0.002, 0.006, 0.02])


def test_the_table_by_scan_counts_all_runs() -> None:
    before, first, _, third = text_of(by_scan(RUNS, 3))
    assert before[:4] == ["none", "3", "", "2.00"]
    assert first == ["1", "3", "2", "1.27", "1.20", "0.57", "1.92", "67%", "0%", "10.0%", "8.0", "50"]
    assert third[:5] == ["3", "3", "1", "0.93", "0.60"]


def test_the_table_by_object_has_a_line_for_each() -> None:
    box, mug = text_of(by_object(RUNS, 3))
    assert box[:4] == ["box", "1", "2.00", "2.00"]
    assert mug[:6] == ["mug", "2", "2.00", "0.90", "0.40", "0.40"]


def test_the_table_by_engine_has_a_line_for_each_engine_and_scan() -> None:
    other = [run_of("mug", 0, 0.002, engine="paper"), Run("mug", 1, "paper", "ideal", None, problem="broken")]
    lines = text_of(by_engine([*RUNS, *other], 2))
    assert [line[:4] for line in lines] == [
        ["point_to_plane", "ideal", "1", "3"],
        ["point_to_plane", "ideal", "2", "3"],
        ["paper", "ideal", "1", "1"],
        ["paper", "ideal", "2", "1"],
    ]
    assert lines[0][4:] == ["1.27", "1.20", "0.57", "1.92", "67%", "0%", "0.40", "10.0%", "8.0", "50", "50"]


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
    assert lines[0]["distance2"] == 4.0
    assert len(lines[0]["whitened"]) == 6


def test_runs_that_are_kept_are_not_made_again(tmp_path: Path) -> None:
    kept = PartialResults(tmp_path / "out.json", PROTOCOL)
    tasks = [(tmp_path / "mug.ply", 0), (tmp_path / "mug.ply", 1)]
    protocols = [replace(PROTOCOL, engine=engine) for engine in (Engine.PAPER, Engine.POSTERIOR)]
    for mesh, view, engine, _ in keys(tasks, protocols):
        kept.add(run_of(mesh, view, 0.01, engine=engine))
    runs = run_all(tasks, protocols, 1, kept, lambda run: pytest.fail("made again"))
    assert [(run.engine, run.view) for run in runs] == [
        ("paper", 0),
        ("paper", 1),
        ("posterior", 0),
        ("posterior", 1),
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
    assert again.runs == {("mug", 0, "point_to_plane", "ideal"): RUNS[0]}


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
