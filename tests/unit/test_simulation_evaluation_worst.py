"""The worst runs of an evaluation, with the numbers that explain them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.made_runs import KEY, run_of
from PIL import Image
from pretouch_registrar.engines import Engine
from pretouch_simulation.evaluation import Step, run_steps
from pretouch_simulation.evaluation_protocol import Protocol
from pretouch_simulation.finger import FingerModel
from pretouch_simulation.objects import box
from pretouch_simulation.protocol import CAMERA, Case, make_case
from pretouch_simulation.worst import Diagnosis, Met, diagnose, identify_surfaces, worst_runs
from pretouch_simulation.worst_picture import Failure, save_worst

from pretouch.session import Planner, Proposer

PROTOCOL = Protocol(2, Proposer.RANDOM, Engine.PAPER, Planner.CONFIDENCE, FingerModel.IDEAL, seed=0)
CALM = Diagnosis(
    error=0.01,
    expected_error=0.009,
    distance2=4.0,
    weakest="",
    beams=200,
    returns=120,
    met={Met.SEEN: 80, Met.HIDDEN: 10, Met.BLIND: 0, Met.TABLE: 30},
    flat=0.5,
    second_distance=None,
    second_error=None,
)


@pytest.fixture(scope="module")
def case() -> Case:
    return make_case("box", box(), 0)


@pytest.fixture(scope="module")
def steps(case: Case) -> list[Step]:
    return run_steps(case, PROTOCOL, 2)


def test_the_worst_come_first_and_runs_without_scans_do_not_count() -> None:
    errors = {"a": (0.01, 0.001), "b": (0.03, 0.002), "c": (0.02,), "d": ()}
    runs = [run_of(KEY._replace(mesh=name), *after) for name, after in errors.items()]
    assert [run.mesh for run in worst_runs(runs, 1, 2)] == ["b", "c"]
    assert [run.mesh for run in worst_runs(runs, 2, 5)] == ["c", "b", "a"]


def test_what_the_finger_met_is_told_by_the_true_camera(case: Case) -> None:
    true_cloud = case.truth.apply(case.cloud)
    assert (identify_surfaces(case, true_cloud[true_cloud[:, 2] > 0.02]) == Met.SEEN).mean() > 0.98
    view = case.truth.rotate(case.base_T_camera.rotation[:, 2][None])
    behind = true_cloud + 0.02 * view
    assert (identify_surfaces(case, behind[behind[:, 2] > 0.01]) == Met.HIDDEN).mean() > 0.98
    assert set(identify_surfaces(case, [[0.5, 0.0, 0.001]])) == {Met.TABLE}
    assert identify_surfaces(case, np.zeros((0, 3))).shape == (0,)


def test_a_point_outside_the_image_is_where_there_is_no_depth(case: Case) -> None:
    base_T_camera = case.truth @ case.base_T_camera
    above = base_T_camera.apply(CAMERA.back_project([[320.0, -50.0]], [0.6]))
    assert list(identify_surfaces(case, above)) == [Met.BLIND]


def test_a_diagnosis_adds_up(case: Case, steps: list[Step]) -> None:
    record = steps[-1].record
    one = diagnose(case, record, Engine.PAPER)
    assert one.error == case.error(record.estimate.base_T_correction)
    assert one.beams == sum(len(scan) for scan in record.measured)
    assert sum(one.met.values()) == one.returns == sum(int(scan.returned.sum()) for scan in record.measured)
    assert (one.distance2 <= 12.59) == case.is_covered_by(record.estimate)
    assert 0 <= one.flat <= 1
    assert (one.second_distance, one.second_error) == (None, None)


def test_a_run_is_played_again_as_it_was(case: Case, steps: list[Step]) -> None:
    again = run_steps(case, PROTOCOL, 1)
    assert len(again) == 1
    first, same = steps[0].record.estimate, again[0].record.estimate
    np.testing.assert_array_equal(first.base_T_correction.matrix, same.base_T_correction.matrix)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({}, "no single cause"),
        (
            {"met": {Met.SEEN: 5, Met.HIDDEN: 2, Met.BLIND: 0, Met.TABLE: 113}},
            "too few returns from the object: 7 of 200",
        ),
        ({"second_distance": 0.039, "second_error": 0.002}, "two places agree: the right one is 3.9 cm away"),
        ({"second_distance": 0.039, "second_error": 0.03}, "no single cause"),
        ({"met": {Met.SEEN: 40, Met.HIDDEN: 40, Met.BLIND: 20, Met.TABLE: 20}}, "saw nothing: 60%"),
        ({"flat": 0.95}, "level surfaces only (95% of the hits)"),
        ({"distance2": 30.0}, "surer than it should be"),
        ({"weakest": "sliding along base x"}, "sliding along base x"),
    ],
)
def test_the_reason_follows_from_the_numbers(changes: dict[str, object], reason: str) -> None:
    assert reason in replace(CALM, **changes).reason  # type: ignore[arg-type]


def test_failures_are_drawn_a_line_each(case: Case, steps: list[Step], tmp_path: Path) -> None:
    one = Failure("box, view 0", case, steps[0].record, diagnose(case, steps[0].record, Engine.PAPER))
    save_worst([one], "one", tmp_path / "one.png")
    save_worst([one, one], "two", tmp_path / "two.png")
    with Image.open(tmp_path / "one.png") as single, Image.open(tmp_path / "two.png") as double:
        assert single.width == double.width
        assert double.height == pytest.approx(2 * single.height, abs=2)
        assert len(single.getcolors() or []) > 16
