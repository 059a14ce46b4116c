"""Images that are larger or finer than needed are cropped and downsampled, and the estimate hardly changes."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.scenes import KINECT, Box, View, World
from pretouch_registrar import downsampling as module
from pretouch_registrar.downsampling import downsample_scene
from pretouch_registrar.registration import Registrar, Settings

from pretouch.camera import Camera
from pretouch.geometry import Pose
from pretouch.tof import Sensor
from pretouch.trajectory import Trajectory

REGISTRAR = Registrar()

WORLD = World((Box.standing((0.10, 0.06, 0.05), yaw=0.4),))
CLOSE = View(camera=Camera(2100.0, 2100.0, 799.5, 599.5), width=1600, height=1200)
TRUTH = Pose.from_rotation_vector((0.02, -0.02, 0.05), (0.01, -0.008, 0.012))


def test_a_view_of_usual_size_is_left_alone() -> None:
    scene = WORLD.scene(KINECT).cropped(0.1)[0]
    assert downsample_scene(scene) is scene


def test_a_whole_image_is_cut_to_the_object_and_answered_alike() -> None:
    whole = WORLD.scene(KINECT)
    cut = downsample_scene(whole)
    assert cut.mask.size < whole.mask.size / 2
    assert cut.mask.sum() == whole.mask.sum()
    np.testing.assert_allclose(cut.cloud, whole.cloud, atol=1e-9)


@pytest.mark.parametrize("most", [100_000, 20_000, 3_000])
def test_a_fine_view_is_downsampled_in_place(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    monkeypatch.setattr(module, "MAX_OBJECT_PIXELS", most)
    fine = WORLD.scene(CLOSE)
    coarse = downsample_scene(fine)
    assert coarse.mask.size < fine.mask.size
    assert min(most, fine.mask.sum()) / 5 < coarse.mask.sum() <= 1.1 * most
    np.testing.assert_allclose(coarse.centroid, fine.centroid, atol=5e-4)
    on_box = WORLD.distance(coarse.cloud)
    assert on_box.max() < 1e-4


def test_a_fine_view_is_answered_as_a_usual_one(monkeypatch: pytest.MonkeyPatch) -> None:
    tips = np.tile(np.eye(4), (2, 1, 1))
    tips[:, :3, :3] = np.diag([1.0, -1.0, -1.0])
    ends = [((-0.08, -0.01), (0.08, 0.01)), ((0.01, -0.08), (-0.01, 0.08)), ((-0.07, 0.05), (0.07, -0.04))]
    scans = []
    for k, (start, end) in enumerate(ends):
        tips[:, :3, 3] = (*start, 0.085), (*end, 0.085)
        path = Trajectory(np.array([0.0, 3.0]), tips.copy())
        scans.append(WORLD.moved(TRUTH).scanned(path, Sensor(), np.random.default_rng(k)).beams(Sensor()))
    monkeypatch.setattr(module, "MAX_OBJECT_PIXELS", 10_000)
    fine = WORLD.scene(CLOSE, np.random.default_rng(0))
    answer = REGISTRAR.register(fine, scans, Settings())
    error = np.linalg.norm(answer.base_T_correction.apply(fine.cloud) - TRUTH.apply(fine.cloud), axis=1).mean()
    assert error < 0.005
    assert error < answer.error_quantile
