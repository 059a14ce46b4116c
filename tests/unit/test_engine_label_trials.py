"""Scores of many trials: correct, independent of the number of threads, and with the same winner when pruned."""

import numpy as np
import pytest
from helpers.scenes import Box, World
from pretouch_registrar.engines import icp
from pretouch_registrar.engines.label_trials import Matching, TrialSettings, View, compute_scores, find_best
from pretouch_registrar.engines.neighbours import build_index

from pretouch.errors import PretouchError
from pretouch.geometry import Array, Pose
from pretouch.rectangle import RotatedRectangle


@pytest.fixture(scope="module")
def view() -> View:
    scene = World((Box.standing((0.10, 0.06, 0.05), (0.0, 0.0), 0.4),)).scene(noise=np.random.default_rng(5))
    scene = scene.cropped(0.02)[0]
    cloud = scene.camera.back_project_image(scene.depth.metres)
    normals = np.broadcast_to(scene.base_T_camera.inverse().rotate([0.0, 0.0, 1.0]), cloud.shape)
    return View(cloud, scene.mask, scene.camera, normals)


@pytest.fixture(scope="module")
def offsets() -> Array:
    rng = np.random.default_rng(1)
    return np.column_stack([rng.uniform(-0.08, 0.08, (4, 3)), rng.uniform(-0.02, 0.02, (4, 3))])


@pytest.fixture(scope="module")
def rectangles(view: View) -> Array:
    rng = np.random.default_rng(2)
    v, u = np.nonzero(view.mask)
    centre = rng.uniform((u.min(), v.min()), (u.max(), v.max()), (40, 2))
    return np.column_stack([centre, rng.uniform(8, 30, (40, 2)), rng.uniform(-1.5, 1.5, 40)])


@pytest.mark.parametrize("matching", list(Matching))
def test_pruning_finds_the_same_winner(view: View, rectangles: Array, offsets: Array, matching: Matching) -> None:
    trials = TrialSettings(matching, seed=3)
    worst = compute_scores(view, rectangles, offsets, trials, threads=2).max(axis=1)
    for threads in (1, 3):
        assert find_best(view, rectangles, offsets, trials, threads) == (int(worst.argmin()), worst.min())


def test_scores_depend_on_the_seed_and_not_on_threads_or_on_how_a_list_is_split(
    view: View, rectangles: Array, offsets: Array
) -> None:
    whole = compute_scores(view, rectangles, offsets, TrialSettings(seed=7), threads=1)
    np.testing.assert_array_equal(compute_scores(view, rectangles, offsets, TrialSettings(seed=7), threads=4), whole)
    np.testing.assert_array_equal(
        compute_scores(view, rectangles[25:], offsets, TrialSettings(seed=7), first=25), whole[25:]
    )
    assert (compute_scores(view, rectangles, offsets, TrialSettings(seed=8)) != whole).any()


def test_a_score_is_the_papers_algorithm_written_out(view: View, rectangles: Array, offsets: Array) -> None:
    trials = TrialSettings(Matching.PLAIN, noise=0.0)
    found = compute_scores(view, rectangles[:6], offsets, trials)
    cloud, centre = view.cloud[view.mask], view.cloud[view.mask].mean(axis=0)
    for b, row in enumerate(rectangles[:6]):
        rectangle = RotatedRectangle(*row)
        target = cloud[np.abs(rectangle.distance(view.camera.project(cloud))) <= trials.near]
        for j, offset in enumerate(offsets):
            moved = Pose.from_rotation_vector(offset[:3], [0, 0, 0]).apply(cloud - centre) + centre + offset[3:]
            on = np.abs(rectangle.distance(view.camera.project(moved))) <= trials.on
            r, t = np.eye(3), np.zeros(3)
            if icp.align(moved[on], build_index(target), False, r, t) == 0:
                r, t = np.eye(3), np.zeros(3)
            error = np.linalg.norm(moved[on] @ r.T + t - cloud[on], axis=1).mean()
            assert found[b, j] == pytest.approx(error, abs=2e-4)


def test_without_a_point_on_the_perimeter_nothing_is_gained(view: View, offsets: Array) -> None:
    cloud, centre = view.cloud[view.mask], view.cloud[view.mask].mean(axis=0)
    away = compute_scores(view, [[-500.0, -500.0, 10.0, 10.0, 0.0]], offsets, TrialSettings())
    moved = [Pose.from_rotation_vector(o[:3], [0, 0, 0]).apply(cloud - centre) + centre + o[3:] for o in offsets]
    np.testing.assert_allclose(away[0], [np.linalg.norm(m - cloud, axis=1).mean() for m in moved])


def test_what_cannot_be_scored_is_refused(view: View, rectangles: Array, offsets: Array) -> None:
    with pytest.raises(PretouchError, match="normals"):
        compute_scores(
            View(view.cloud, view.mask, view.camera), rectangles, offsets, TrialSettings(Matching.POINT_TO_PLANE)
        )
    with pytest.raises(PretouchError, match="no rectangle"):
        compute_scores(view, np.zeros((0, 5)), offsets, TrialSettings())
    with pytest.raises(PretouchError, match="mask"):
        View(view.cloud, np.zeros_like(view.mask), view.camera)
    with pytest.raises(PretouchError):
        compute_scores(view, [[np.nan] * 5], offsets, TrialSettings())
