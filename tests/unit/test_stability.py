"""Proposer `stability` predicts the information of a scan: surfaces, edges, the table, and the sensor's range."""

import numpy as np
import pytest
from helpers.predictions import predict_errors
from helpers.scenes import KINECT, Box, View, World, looking
from pretouch_detector.proposals import propose
from pretouch_detector.proposals.information import predict_errors_after_scans
from pretouch_orchestrator.planning.path import plan_paths
from pretouch_registrar.registration import Registrar, Settings
from scipy.stats import spearmanr

from pretouch.estimate import from_prior
from pretouch.geometry import Pose
from pretouch.prior import Prior
from pretouch.rectangle import RotatedRectangle
from pretouch.scene import Scene
from pretouch.session import Proposer, ScanSettings
from pretouch.tof import Sensor

REGISTRAR = Registrar()

WIDE = World((Box.standing((0.16, 0.16, 0.04)),))
STEPPED = World((Box.standing((0.16, 0.16, 0.03)), Box.standing((0.05, 0.05, 0.02), lift=0.03)))


def stepped() -> Scene:
    """Both boxes are the object."""
    view = View()
    depth, _ = STEPPED.depth(view)
    points = view.base_T_camera.apply(view.camera.back_project_image(depth.metres))
    return Scene(depth, view.camera, view.base_T_camera, points[..., 2] > 0.005, STEPPED.table)


def around(scene: Scene, place: tuple[float, float, float], side: float) -> list[float]:
    """[x, y, w, h, theta] of a level rectangle about a place (m, base), `side` pixels wide."""
    u, v = scene.camera.project(scene.base_T_camera.inverse().apply(place))
    return [u, v, side, 0.7 * side, 0.0]


def left(scene: Scene, *rectangles: list[float], sensor: Sensor | None = None) -> np.ndarray:
    return predict_errors_after_scans(scene, sensor or Sensor(), np.array(rectangles))[0]


def test_a_perimeter_over_edges_tells_more_than_one_within_a_face() -> None:
    scene = WIDE.scene()
    corner, face = left(scene, around(scene, (0.08, 0.08, 0.04), 30), around(scene, (0, 0, 0.04), 12))
    assert corner < 0.7 * face


def test_edges_within_the_object_count() -> None:
    flat, step = WIDE.scene(), stepped()
    over_step = (
        left(step, around(step, (0, 0, 0.04), 16))[0] / predict_errors_after_scans(step, Sensor(), np.eye(5)[:0])[1]
    )
    over_face = (
        left(flat, around(flat, (0, 0, 0.04), 16))[0] / predict_errors_after_scans(flat, Sensor(), np.eye(5)[:0])[1]
    )
    assert over_step < 0.9 * over_face


def test_the_table_fixes_height_and_tilt_though_nothing_else() -> None:
    scene = World((Box.standing((0.02, 0.02, 0.02)),)).scene(KINECT)
    beside = around(scene, (0, 0, 0.0), 28)
    upright = Prior(translation_std=0.003, rotation_std=1e-6)
    after, before = predict_errors_after_scans(scene, Sensor(), np.array([beside]), upright)
    assert 0.5 * before < after[0] < 0.9 * before
    deep = Sensor(range_min=0.001, range_max=0.05)
    after, before = predict_errors_after_scans(scene, deep, np.array([beside]), upright)
    assert after[0] > 0.9 * before


def test_beyond_its_range_the_sensor_learns_nothing_of_the_table() -> None:
    scene = World((Box.standing((0.06, 0.06, 0.05)),)).scene()
    beside = around(scene, (0, 0, 0.05), 40)
    near, far = (left(scene, beside, sensor=Sensor(range_max=reach))[0] for reach in (0.06, 0.15))
    assert far < near


def test_a_perimeter_that_never_comes_near_the_object_leaves_all_as_it_was() -> None:
    scene = WIDE.scene()
    after, before = predict_errors_after_scans(
        scene, Sensor(), np.array([[15.0, 12.0, 10.0, 8.0, 0.3], [-90.0, 0, 9, 9, 0]])
    )
    np.testing.assert_allclose(after, before)


def test_before_any_scan_it_is_the_prior_s_root_mean_square() -> None:
    scene = WIDE.scene()
    prior = Prior(0.01, 0.04)
    draws = np.random.default_rng(0).normal(size=(4000, 6)) * np.repeat([0.04, 0.01], 3)
    arms = (scene.cloud - scene.centroid)[::50]
    moved = np.cross(draws[:, None, :3], arms) + draws[:, None, 3:]
    _, before = predict_errors_after_scans(scene, Sensor(), np.zeros((0, 5)), prior)
    assert before == pytest.approx(np.sqrt((moved**2).sum(axis=2).mean()), rel=0.03)


def test_neither_the_base_frame_nor_the_image_s_size_matters() -> None:
    scene = WIDE.scene(KINECT)
    boxes = np.array([r.rectangle.as_list() for r in propose(scene, Proposer.RANDOM, Sensor(), 30, 1).regions])
    expected = left(scene, *boxes)
    base_T_old = Pose.from_rotation_vector((0.3, -0.2, 1.1), (0.4, 0.1, -0.2))
    elsewhere = Scene(
        scene.depth, scene.camera, base_T_old @ scene.base_T_camera, scene.mask, scene.table.moved(base_T_old)
    )
    assert spearmanr(left(elsewhere, *boxes), expected)[0] > 0.97
    small = WIDE.scene()
    assert spearmanr(left(small, *(boxes * [0.5, 0.5, 0.5, 0.5, 1] - [0.25, 0.25, 0, 0, 0])), expected)[0] > 0.9


def test_it_ranks_much_as_the_registrar_predicts() -> None:
    scene = World((Box.standing((0.10, 0.06, 0.05), yaw=0.4),)).scene(View(looking((0, 0, 0.02))))
    boxes = [r.rectangle for r in propose(scene, Proposer.RANDOM, Sensor(), 40, 3).regions]
    paths = plan_paths(scene, boxes, from_prior(Prior(), scene.cloud), ScanSettings())
    there = [k for k, path in enumerate(paths) if path is not None]
    predicted = predict_errors(REGISTRAR, scene, [], Settings(), [path for path in paths if path is not None])
    own = left(scene, *(RotatedRectangle.as_list(boxes[k]) for k in there))
    assert spearmanr(own, predicted)[0] > 0.5
