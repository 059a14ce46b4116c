"""Real frames are read, levelled and given a hidden error; errors in a file are reported."""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.made_frame import write_frame
from pretouch_simulation.frames import frame_case, load_frame
from pretouch_simulation.protocol import PLACE

from pretouch.errors import InvalidInput, Malformed, NotFound
from pretouch.geometry import Pose

SHARED = Path(os.environ.get("PRETOUCH_SHARED", Path(__file__).parents[3] / "shared"))
REAL = SHARED / "data" / "real_depth" / "ycb_video"


@pytest.fixture
def frame_file(tmp_path: Path) -> Path:
    return write_frame(tmp_path)


def changed(path: Path, **members: Any) -> Path:
    path.write_text(json.dumps({**json.loads(path.read_text()), **members}))
    return path


def test_a_frame_stands_upright_with_the_object_ahead(frame_file: Path) -> None:
    case = frame_case(load_frame(frame_file), "can", seed=0)
    table = case.world.table
    np.testing.assert_allclose(table.normal, [0, 0, 1], atol=1e-9)
    assert table.offset == pytest.approx(0, abs=1e-9)
    corrected = case.truth.apply(case.cloud)
    np.testing.assert_allclose(corrected.mean(axis=0)[:2], PLACE[:2], atol=1e-6)
    assert np.quantile(corrected[:, 2], 0.02) > -0.01
    assert np.quantile(corrected[:, 2], 0.98) < 0.07
    assert (case.truth @ case.base_T_camera).translation[2] == pytest.approx(0.7 * np.sin(0.9), abs=0.005)


def test_the_finger_meets_all_objects_of_a_frame_at_their_true_places(frame_file: Path) -> None:
    case = frame_case(load_frame(frame_file), "can", seed=0)
    assert len(case.world.bodies) == 2
    top = case.world.bodies[0].base_T_mesh.apply([0, 0, 0.06])
    height = case.world.cast([top + np.array([0, 0, 0.1])], [[0, 0, -1.0]])[0]
    assert height == pytest.approx(0.1, abs=0.002)
    beside = case.world.bodies[1].base_T_mesh.apply([0, 0, 0.05])
    assert case.world.cast([beside + np.array([0, 0, 0.1])], [[0, 0, -1.0]])[0] == pytest.approx(0.1, abs=0.002)


def test_the_offset_is_fixed_by_seed_and_object(frame_file: Path) -> None:
    frame = load_frame(frame_file)
    first = frame_case(frame, "can", seed=1)
    assert first.error(first.truth) == 0
    assert first.truth.is_close(frame_case(frame, "can", seed=1).truth, 0)
    assert not first.truth.is_close(frame_case(frame, "can", seed=2).truth, 1e-3)
    assert not first.truth.is_close(frame_case(frame, "box", seed=1).truth, 1e-3)


def test_an_unknown_object_names_those_that_exist(frame_file: Path) -> None:
    with pytest.raises(NotFound) as refused:
        frame_case(load_frame(frame_file), "teapot", seed=0)
    assert "box, can" in refused.value.remedy


def test_missing_and_broken_files_are_named(frame_file: Path, tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="no frame"):
        load_frame(tmp_path / "other.json")
    (tmp_path / "text.json").write_text("hello")
    with pytest.raises(Malformed, match=r"text\.json is not JSON"):
        load_frame(tmp_path / "text.json")
    with pytest.raises(NotFound, match=r"names gone\.png"):
        load_frame(changed(frame_file, files={"depth": "gone.png", "label": "label.png"}))


@pytest.mark.parametrize(
    ("members", "what"),
    [
        ({"objects": []}, "names no object"),
        ({"objects": [{"name": "box"}]}, "T_cam_obj"),
        ({"width": 320}, "says"),
        ({"fx": 0}, "focal"),
        ({"files": {}}, "depth"),
    ],
)
def test_a_frame_that_does_not_fit_is_refused(frame_file: Path, members: dict[str, Any], what: str) -> None:
    with pytest.raises(InvalidInput, match=what):
        load_frame(changed(frame_file, **members))


@pytest.mark.skipif(not REAL.is_dir(), reason=f"no real frames at {REAL}; set PRETOUCH_SHARED")
def test_real_frames_agree_with_their_ground_truth() -> None:
    frame = load_frame(REAL / "0000_000001.json")
    for thing in frame.objects:
        case = frame_case(frame, thing.name, seed=0)
        camera = case.truth @ case.base_T_camera
        rays = case.truth.apply(case.cloud) - camera.translation
        hits = case.world.trace(np.broadcast_to(camera.translation, rays.shape), rays)
        assert (hits.bodies == 0).mean() > 0.99
        assert np.median(np.abs(hits.distances - 1) * np.linalg.norm(rays, axis=1)) < 0.0015
        assert 0.001 < case.error(Pose.identity()) < 0.05
