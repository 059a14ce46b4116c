"""The order of labelling tasks, the split into sides, and depth frames of other folders."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.made_frame import write_frame
from hypothesis import given
from hypothesis import strategies as st
from pretouch_registrar.engines import Engine
from pretouch_simulation.finger import FingerModel
from pretouch_simulation.labels.frame_task import FrameTask, frame_tasks
from pretouch_simulation.labels.generation import Kind, Outcome, Recipe, try_to_label
from pretouch_simulation.labels.task import tasks_of
from pretouch_simulation.protocol import PLACE

from pretouch.errors import InvalidInput, Malformed, NotFound

STEMS = st.from_regex(r"(ycb__|gso__)?(red_|blue_)?(mug|bowl|can|drill|tea_pot)(_[0-9]|_[a-c])?", fullmatch=True)


@given(st.lists(STEMS, unique=True, min_size=1, max_size=12), st.integers(0, 3), st.integers(1, 3), st.integers(1, 3))
def test_views_are_distinct_mixed_and_no_object_is_on_both_sides(
    stems: list[str], made: int, poses: int, views: int
) -> None:
    tasks = tasks_of([Path(f"{stem}.ply") for stem in stems], made, poses, views)
    assert len({(task.side, task.name) for task in tasks}) == len(tasks) == (len(stems) + made) * poses * views
    first = tasks[: len(stems) + made]
    assert len({task.stem for task in first}) == len(first)
    sides: dict[str, set[str]] = {}
    for task in tasks:
        sides.setdefault(task.object, set()).add(task.side)
    assert all(len(found) == 1 for found in sides.values())


def test_without_any_object_there_is_nothing_to_do() -> None:
    with pytest.raises(InvalidInput, match="no object") as refused:
        tasks_of([], 0, 1, 1)
    assert "--frames" in refused.value.remedy


@pytest.mark.parametrize(
    ("settings", "what"),
    [
        ({"kind": Kind.TRIALS}, "does not match by posterior"),
        ({"kind": Kind.TRIALS, "engine": Engine.PAPER, "finger": FingerModel.VL6180X}, "knows no finger"),
        ({"best_only": True}, "pruned"),
        ({"scanned": 41}, "41 of 40"),
        ({"trials": 0}, "0 trials"),
    ],
)
def test_a_recipe_that_makes_no_sense_is_refused(settings: dict[str, Any], what: str) -> None:
    with pytest.raises(InvalidInput, match=what) as refused:
        Recipe(**settings)
    assert refused.value.remedy


@pytest.fixture
def frame_file(tmp_path: Path) -> Path:
    return write_frame(tmp_path)


def changed(path: Path, **members: Any) -> Path:
    description = {**json.loads(path.read_text()), **members}
    path.write_text(json.dumps({name: value for name, value in description.items() if value is not None}))
    return path


def test_each_object_of_a_frame_is_a_view_upright_on_the_table(frame_file: Path) -> None:
    tasks = frame_tasks(frame_file.parent)
    assert [(task.name, task.object) for task in tasks] == [("frame-3", "box"), ("frame-4", "can")]
    scene, (u0, v0) = tasks[1].scene(0)
    np.testing.assert_allclose(scene.table.normal, [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(scene.centroid[:2], PLACE[:2], atol=1e-9)
    assert np.quantile(scene.cloud[:, 2], 0.98) == pytest.approx(0.06, abs=0.006)
    assert u0 > 0
    assert v0 > 0
    view = tasks[1].load_view(0)
    assert len(view.case.world.bodies) == 2
    assert view.scene.mask.sum() == scene.mask.sum()


def test_a_frame_needs_neither_names_nor_poses(frame_file: Path) -> None:
    changed(frame_file, objects=[], object_labels=[4])
    (task,) = frame_tasks(frame_file.parent)
    assert (task.name, task.object, task.label) == ("frame-4", "frame", 4)
    assert task.scene(0)[0].mask.sum() > 200
    with pytest.raises(InvalidInput, match="no object with its pose"):
        task.load_view(0)
    changed(frame_file, object_labels=None)
    assert [task.label for task in frame_tasks(frame_file.parent)] == [3, 4]


def test_without_a_label_image_the_object_is_looked_for(frame_file: Path) -> None:
    changed(frame_file, objects=None, files={"depth": "depth.png"})
    (task,) = frame_tasks(frame_file.parent)
    scene, _ = task.scene(0)
    assert task.name == "frame"
    assert np.quantile(scene.cloud[:, 2], 0.98) == pytest.approx(0.05, abs=0.006)  # of the box, which is the larger


@pytest.mark.parametrize(
    ("members", "what"),
    [
        ({"objects": [], "object_labels": []}, "labels no object"),
        ({"objects": [], "object_labels": [9]}, "no pixel of object 9"),
        ({"fx": "wide"}, "fx|camera|misuses"),
        ({"depth_unit_m": None}, "has no depth_unit_m"),
        ({"files": {"depth": "gone.png"}}, "names gone.png"),
    ],
)
def test_a_frame_without_an_object_or_broken_is_said_and_does_not_stop_others(
    frame_file: Path, tmp_path: Path, members: dict[str, Any], what: str
) -> None:
    changed(frame_file, **members)
    recipe = Recipe(Kind.TRIALS, Engine.PAPER, 2, 0, 1)
    for task in frame_tasks(frame_file.parent):
        outcome = try_to_label(task, recipe, tmp_path)
        assert not outcome.defect, outcome
        assert any(part in outcome.problem for part in what.split("|")), outcome


def test_an_empty_or_missing_folder_of_frames_is_said(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="holds no frame"):
        frame_tasks(tmp_path)
    with pytest.raises(NotFound, match="There is no folder"):
        frame_tasks(tmp_path / "none")
    (tmp_path / "text.json").write_text("hello")
    (task,) = frame_tasks(tmp_path)
    with pytest.raises(Malformed, match="is not JSON"):
        task.scene(0)


class OddTask(FrameTask):
    def scene(self, seed: int) -> Any:
        raise ZeroDivisionError("by nought")


def test_a_defect_in_one_view_is_told_from_bad_input(tmp_path: Path) -> None:
    outcome = try_to_label(OddTask(tmp_path / "odd.json"), Recipe(Kind.TRIALS, Engine.PAPER, 2, 0, 1), tmp_path)
    assert outcome == Outcome("odd", "ZeroDivisionError: by nought", defect=True)
