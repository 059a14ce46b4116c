"""Which frames of a folder, and which objects of them, are evaluated."""

import json
from pathlib import Path

import pytest
from helpers.made_frame import write_frame
from pretouch_simulation.evaluation_tasks import FrameTask, frame_tasks
from pretouch_simulation.frame_folder import frames_in
from pretouch_simulation.frames import load_frame

from pretouch.errors import Malformed, NotFound


@pytest.fixture
def frame_file(tmp_path: Path) -> Path:
    return write_frame(tmp_path)


def test_every_large_object_is_a_task_for_each_seed(frame_file: Path) -> None:
    tasks = frame_tasks([frame_file], range(5, 7))
    assert tasks == [FrameTask(frame_file, name, seed) for name in ("box", "can") for seed in (5, 6)]
    assert {task.frame for task in tasks} == {"frame"}


def test_objects_with_too_few_pixels_are_left_out(frame_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frame = load_frame(frame_file)
    sizes = {thing.name: int(frame.mask(thing.name).sum()) for thing in frame.objects}
    small, large = sorted(sizes, key=lambda name: sizes[name])
    monkeypatch.setattr("pretouch_simulation.evaluation_tasks.MIN_PIXELS", sizes[small])
    assert [task.mesh for task in frame_tasks([frame_file], [0])] == [large]
    monkeypatch.setattr("pretouch_simulation.evaluation_tasks.MIN_PIXELS", sizes[large])
    with pytest.raises(NotFound, match=r"No object in frame\.json"):
        frame_tasks([frame_file], [0])


def test_files_without_images_are_no_frames(frame_file: Path) -> None:
    (frame_file.parent / "index.json").write_text(json.dumps(["frame"]))
    (frame_file.parent / "other.json").write_text(frame_file.read_text())
    assert [path.name for path in frames_in(frame_file.parent)] == ["frame.json", "other.json"]
    assert [path.name for path in frames_in(frame_file.parent, ["other"])] == ["other.json"]


def test_a_folder_without_frames_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="no folder"):
        frames_in(tmp_path / "missing")
    with pytest.raises(NotFound, match="no frame"):
        frames_in(tmp_path)
    write_frame(tmp_path)
    with pytest.raises(NotFound) as refused:
        frames_in(tmp_path, ["second"])
    assert "frame" in refused.value.remedy
    (tmp_path / "broken.json").write_text("{")
    with pytest.raises(Malformed, match=r"broken\.json"):
        frames_in(tmp_path)
