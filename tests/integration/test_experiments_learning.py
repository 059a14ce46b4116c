"""The arithmetic of the one-scan experiments by hand numbers, and `table1.py` end to end on objects made in code."""

import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from helpers.made_frame import write_mesh
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.partial_rows import PartialRows

from experiments import one_scan, one_scan_figures, one_scan_text, oracle, table1
from pretouch.errors import Conflict, Malformed

HUGE = 99.0


def test_the_oracle_is_scored_on_the_offsets_that_it_did_not_choose_by() -> None:
    # Even offsets (columns 0, 2) call candidate 0 the best, odd ones (1, 3) candidate 1.
    errors = [[1.0, 7.0, 1.0, 9.0], [6.0, 2.0, 4.0, 2.0], [50.0, 60.0, 70.0, 80.0]]
    assert oracle.oracle(errors, best=1) == pytest.approx(((7 + 9) / 2 + (6 + 4) / 2) / 2)
    assert oracle.hindsight(errors, best=1) == pytest.approx(14 / 4)
    assert oracle.chance(errors) == pytest.approx((18 + 14 + 260) / 12)
    assert oracle.oracle(errors, best=10) == pytest.approx(oracle.chance(errors))
    assert math.isnan(oracle.oracle([[1.0], [2.0]]))


def test_the_best_by_another_order_are_the_first_of_it() -> None:
    assert oracle.average_best([[1.0, 3.0], [5.0, 5.0], [9.0, 11.0]], by=[0.3, 0.2, 0.1], best=2) == pytest.approx(7.5)


def test_the_gain_taken_is_counted_from_chance_to_the_oracle() -> None:
    assert oracle.compute_gap_closed(0.010, 0.004, 0.002) == pytest.approx(0.75)
    assert oracle.compute_gap_closed(0.010, 0.012, 0.002) == pytest.approx(-0.25)
    assert math.isnan(oracle.compute_gap_closed(0.002, 0.001, 0.002))


def row(target: str, subject: str, errors: list[list[float]], **changes: Any) -> Any:
    name, view = target.split()
    values = {
        **{"target": target, "object": name, "view": int(view), "setup": "ideal", "subject": subject, "count": 10},
        **{"offsets": len(errors[0]) if errors else 2, "seed": 0, "errors": errors, "initial": [0.02, 0.04]},
        **{"rectangles": [[0.0, 0.0, 1.0, 1.0, 0.0]] * len(errors), "confidence": [0.5] * len(errors)},
        **{"predicted": [], "pathless": 0, **changes},
    }
    return one_scan.Row(**values)


def test_an_objects_cell_is_over_all_views_and_its_proposals_average_their_offsets() -> None:
    found = one_scan_figures.cell([row("cup 0", "deep", [[0.01, 0.03]]), row("cup 1", "deep", [[0.04, 0.04]])])
    assert found.mean == pytest.approx(0.03)
    assert found.std_runs == pytest.approx(math.sqrt((4 + 0 + 1 + 1) / 4) / 100)
    assert found.std_proposals == pytest.approx(0.01)
    assert (found.runs, found.proposals) == (4, 2)
    assert one_scan_figures.cell([row("cup 0", "narf", [])]) is None


def test_a_proposers_line_averages_objects_and_compares_only_where_there_are_candidates() -> None:
    rows = [
        row("cup 0", "candidates", [[0.02, 0.02], [0.06, 0.06]], predicted=[0.3, 0.1]),
        row("cup 0", "deep", [[0.03, 0.03]]),
        row("cup 1", "deep", [[HUGE, HUGE]]),  # no candidates there: it does not count for the gain
        row("box 0", "deep", [[0.01, 0.01]], pathless=1),
        row("cup 0", "random", [[0.02, 0.02]]),
        row("cup 1", "random", [[0.02, 0.02]]),
        row("box 0", "random", []),
    ]
    deep, random = (one_scan_figures.overall(rows, subject) for subject in ("deep", "random"))
    assert deep.mean == pytest.approx(((0.03 + HUGE) / 2 + 0.01) / 2)
    assert (deep.best_on, random.best_on) == (1, 1)
    assert deep.pathless == pytest.approx(1 / 3)
    assert random.given == pytest.approx(2 / 3)
    assert one_scan_figures.initial(rows) == pytest.approx(0.03)
    # Ten best of two candidates are both of them: nothing is to be gained.
    assert math.isnan(deep.gap)


def test_the_gain_of_a_proposer_is_on_the_views_that_it_shares_with_the_candidates() -> None:
    candidates = [[0.01, 0.01]] * 10 + [[0.05, 0.05]] * 10
    rows = [
        row("cup 0", "candidates", candidates, predicted=[0.0] * 10 + [1.0] * 10),
        row("box 0", "candidates", [[HUGE, HUGE]] * 20, predicted=[0.0] * 20),
        row("cup 0", "deep", [[0.015, 0.015]]),
    ]
    ends = one_scan_figures.ends(rows[:1])
    assert (ends.chance, ends.oracle, ends.predicted) == pytest.approx((0.03, 0.01, 0.01))
    assert one_scan_figures.overall(rows, "deep").gap == pytest.approx(0.75)


def test_the_papers_own_row_stands_beside_ours_and_what_is_not_ready_is_said() -> None:
    text = one_scan_text.section([row("wallet 0", "random", [[0.01, 0.03]])], "ideal", {"deep": "No weights."})
    assert "| wallet | 2.00 (1.00), 1 of 10 | – | 1.16 (0.63) | 1.70 (0.83) | 0.89 (0.66) |" in text
    assert "`deep` is left out: No weights." in text
    assert "n = 1 objects, 1 views" in text
    assert "seed 0" in text


def test_rows_survive_a_kill_in_the_middle_of_a_line(tmp_path: Path) -> None:
    path = tmp_path / "a.partial"
    PartialRows(path, {"seed": 0}).add({"k": 1})
    path.write_text(path.read_text() + '{"k": 2')
    again = PartialRows(path, {"seed": 0})
    assert again.rows == [{"k": 1}]
    again.add({"k": 3})
    assert PartialRows(path, {"seed": 0}).rows == [{"k": 1}, {"k": 3}]
    with pytest.raises(Conflict):
        PartialRows(path, {"seed": 1})


def test_two_candidates_are_scanned_predicted_and_compared_under_the_same_offset(meshes: Path) -> None:
    one_scan.prepare(["ideal", "paper"])
    target = one_scan.Target(meshes / "drill.obj", 0)
    by_finger, by_cut = (one_scan.run_job(one_scan.Job(target, s, "candidates", 2, 1, 0)) for s in ("ideal", "paper"))
    assert by_finger.problem == by_cut.problem == ""
    assert by_finger.rectangles == by_cut.rectangles
    assert by_finger.initial == by_cut.initial
    assert 0.003 < by_finger.initial[0] < 0.06
    assert [len(one) for one in by_finger.errors] == [1, 1]
    assert 0 < min(by_finger.errors)[0] < by_finger.initial[0]
    assert len(by_finger.predicted) == 2
    assert by_cut.predicted == []
    assert one_scan.run_job(one_scan.Job(target, "paper", "candidates", 2, 1, 0)) == by_cut


def test_what_cannot_be_seen_is_part_of_the_answer(tmp_path: Path) -> None:
    (tmp_path / "nothing.obj").write_text("v 0 0 0\n")
    row = one_scan.run_job(one_scan.Job(one_scan.Target(tmp_path / "nothing.obj", 0), "ideal", "random", 2, 1, 0))
    assert row.problem
    assert row.errors == []


def test_earlier_rows_stay_where_they_fit_beside_the_new_ones(tmp_path: Path) -> None:
    def made(target: str, setup: str, subject: str, **changes: Any) -> Any:
        return row(target, subject, [[0.01, 0.02]], setup=setup, **changes)

    earlier = [
        *(made("cup 0", setup, subject) for setup in ("ideal", "paper") for subject in ("random", "deep")),
        made("cup 1", "ideal", "random"),
        made("cup 1", "paper", "random"),
        made("hat 0", "paper", "random"),
        made("cup 0", "ideal", "narf", seed=1),
    ]
    path = tmp_path / "table1.json"
    assert table1.read_fitting_rows(path, [], []) == ([], [])
    path.write_text(json.dumps({"commands": ["first"], "rows": [one.as_dict() for one in earlier]}))
    job = one_scan.Job(one_scan.Target(Path("cup.ply"), 0), "ideal", "deep", 10, 2, 0)
    kept_rows, commands = table1.read_fitting_rows(path, [made("cup 0", "ideal", "deep")], [job])
    # Made anew: deep under the ideal finger. Unfit: another view of that setup, another object, another seed.
    assert [one.key for one in kept_rows] == [
        ("cup 0", "ideal", "random"),
        ("cup 0", "paper", "random"),
        ("cup 0", "paper", "deep"),
        ("cup 1", "paper", "random"),
    ]
    assert commands == ["first"]
    path.write_text("{}")
    with pytest.raises(Malformed):
        table1.read_fitting_rows(path, [], [])


def run_table1(meshes: Path, out: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "experiments.table1", "--meshes", str(meshes), "--out", str(out), *options]
    return subprocess.run(command, capture_output=True, text=True, timeout=240)


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("meshes")
    write_mesh(folder / "drill.obj", MAKERS["drill"]())
    return folder


def test_table1_is_made_and_another_proposer_can_be_added(meshes: Path, tmp_path: Path) -> None:
    options = ("--views", "1", "--offsets", "2", "--settings", "paper", "--workers", "1", "--candidates", "12")
    done = run_table1(meshes, tmp_path, *options, "--proposers", "random")
    assert done.returncode == 0, done.stderr[-2000:]
    first = json.loads((tmp_path / "table1.json").read_text())["rows"]
    assert [(one["subject"], len(one["errors"]), len(one["errors"][0])) for one in first] == [
        ("candidates", 12, 2),
        ("random", 10, 2),
        ("algorithm 1", 10, 2),
    ]
    assert not (tmp_path / "table1.partial").exists()
    # With the same offsets and the same seed, the first ten candidates are proposer random's.
    assert first[0]["rectangles"][:10] == first[1]["rectangles"]
    done = run_table1(meshes, tmp_path, *options, "--proposers", "stability", "--candidates", "0")
    assert done.returncode == 0, done.stderr[-2000:]
    content = json.loads((tmp_path / "table1.json").read_text())
    assert [one["subject"] for one in content["rows"]] == ["candidates", "random", "stability", "algorithm 1"]
    assert [content["rows"][k] for k in (0, 1, 3)] == first
    assert len(content["commands"]) == 2
    text = (tmp_path / "table1.md").read_text()
    assert "| object | random | stability | algorithm 1 |" in text
    assert "oracle: its 10 best" in text
    assert (tmp_path / "table1.png").stat().st_size > 1000


def test_table1_says_what_is_wrong_without_a_stack_trace(tmp_path: Path) -> None:
    done = run_table1(tmp_path / "nowhere", tmp_path)
    assert done.returncode == 1
    assert "There is no folder" in done.stderr
    assert "Traceback" not in done.stderr
