"""The fit of a real frame finds the bias of its depth, and keeps unobservable directions."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.made_frame import write_frame
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.evaluation import Subject
from pretouch_simulation.evaluation_tasks import FrameTask, MeshTask, frame_tasks
from pretouch_simulation.fitted_truth import TURN_STD, fit_truth
from pretouch_simulation.frame_folder import frames_in
from pretouch_simulation.frames import frame_case, load_frame
from pretouch_simulation.protocol import Case

from pretouch.camera import DepthImage
from pretouch.geometry import vector_from_rotation

SHARED = Path(os.environ.get("PRETOUCH_SHARED", Path(__file__).parents[3] / "shared"))
REAL = SHARED / "data" / "real_depth" / "ycb_video"


@pytest.fixture(scope="module")
def frame_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_frame(tmp_path_factory.mktemp("frames"))


def biased(case: Case, metres: float) -> Case:
    """The case with all depth further away; the truth as it was."""
    depth = case.depth.metres
    return replace(case, depth=DepthImage(np.where(depth > 0, depth + metres, 0).astype(np.float32)))


@pytest.mark.parametrize("name", ["box", "can"])
def test_a_depth_bias_is_found(frame_file: Path, name: str) -> None:
    case = frame_case(load_frame(frame_file), name, seed=0)
    unbiased = fit_truth(case)
    assert case.error(unbiased) < 0.0005
    moved = biased(case, 0.004)
    fitted = replace(moved, truth=fit_truth(moved))
    axis = (moved.truth @ moved.base_T_camera).rotation[:, 2]
    shift = fitted.truth.apply(moved.cloud).mean(axis=0) - moved.truth.apply(moved.cloud).mean(axis=0)
    np.testing.assert_allclose(shift, -0.004 * axis, atol=0.0008)
    assert fitted.error(moved.truth) == pytest.approx(0.004, abs=0.0008)


def test_round_things_do_not_turn_about_their_axis(frame_file: Path) -> None:
    case = frame_case(load_frame(frame_file), "can", seed=0)
    turn = vector_from_rotation((fit_truth(biased(case, 0.004)) @ case.truth.inverse()).rotation)
    assert abs(turn[2]) < 0.1 * TURN_STD


def test_only_frames_are_fitted(frame_file: Path) -> None:
    assert Subject.of(FrameTask(frame_file, "box", 0), 0, CameraModel.KINECT).fitted is not None
    assert Subject.of(MeshTask(frame_file.parent / "box.obj", 0), 0, CameraModel.KINECT).fitted is None


@pytest.mark.skipif(not REAL.is_dir(), reason=f"no real frames at {REAL}; set PRETOUCH_SHARED")
def test_real_depth_is_biased_by_millimetres() -> None:
    for task in frame_tasks(frames_in(REAL, ["0000_000001", "0003_000138"]), [0]):
        subject = Subject.of(task, 0, CameraModel.KINECT)
        assert subject.fitted is not None
        assert 0 < subject.fitted.error(subject.case.truth) < 0.008
