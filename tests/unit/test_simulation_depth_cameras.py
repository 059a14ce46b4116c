"""The simulated cameras have the errors of their kind, drawn from a seed alone."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pretouch_simulation.depth_cameras import CameraModel, Rendering, realise
from pretouch_simulation.depth_cameras.fields import block_field, smooth_field
from pretouch_simulation.depth_cameras.kinect import Kinect
from pretouch_simulation.depth_cameras.matching import WindowCamera
from pretouch_simulation.objects import box, drill
from pretouch_simulation.protocol import CAMERA, case_of, generator, make_case
from pretouch_simulation.stable_pose import stand
from pretouch_simulation.world import Body, World

from pretouch.geometry import Plane, Pose, rotation_from_vector

FLOOR = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
LOOKING_DOWN = np.diag([1.0, -1.0, -1.0])
FOREIGN = (CameraModel.WINDOW, CameraModel.STEREO)
SIDE = 0.1


def image_of(
    world: World, model: CameraModel, height: float, seed: int = 0, shape: tuple[int, int] = (480, 640)
) -> Rendering:
    rng = np.random.default_rng([seed, 1])
    return realise(model, np.random.default_rng(seed)).render(
        world, CAMERA, Pose.of(LOOKING_DOWN, [0, 0, height]), rng, shape
    )


def on_a_pole(depth: float = 0.6) -> World:
    """A plate far above the table."""
    return World([Body(box(SIDE, SIDE, 0.01), Pose.of(np.eye(3), [0, 0, depth]))], FLOOR)


def true_square(height: float) -> NDArray[np.bool_]:
    v, u = np.indices((480, 640))
    half = SIDE / 2 / height * CAMERA.fx
    return np.asarray((np.abs(u - CAMERA.cx) <= half) & (np.abs(v - CAMERA.cy) <= half), dtype=np.bool_)


def residual(model: CameraModel, seed: int, height: float = 0.9) -> NDArray[Any]:
    values = image_of(World([], FLOOR), model, height, seed, (240, 320)).depth.metres.astype(np.float64)
    return np.where(values > 0, values - height, np.nan)


@pytest.mark.parametrize("model", list(CameraModel))
def test_the_same_seeds_render_the_same_image_and_others_another(model: CameraModel) -> None:
    first, again = (make_case("drill", drill(), 0, 0, model) for _ in range(2))
    np.testing.assert_array_equal(first.depth.metres, again.depth.metres)
    np.testing.assert_array_equal(first.mask, again.mask)
    np.testing.assert_array_equal(first.truth.matrix, again.truth.matrix)
    assert not np.array_equal(first.depth.metres, make_case("drill", drill(), 0, 1, model).depth.metres)


def test_the_kinect_s_cases_are_scored_where_the_client_s_mask_is() -> None:
    case = make_case("drill", drill(), 0)
    np.testing.assert_array_equal(case.mask, case.scored)
    again = case_of("drill", stand(drill()), 0, generator("view", 0, "drill", 0))
    np.testing.assert_array_equal(case.depth.metres, again.depth.metres)
    assert case.mask.sum() == 5199
    assert float(case.depth.metres.astype(np.float64).sum()) == pytest.approx(333032.1898, abs=0.01)


@pytest.mark.parametrize("model", FOREIGN)
def test_masks_stray_from_the_truth_but_overlap_it(model: CameraModel) -> None:
    image = image_of(on_a_pole(), model, 1.4)
    true = image.bodies == 0
    seen = true & (image.depth.metres > 0)
    assert not np.array_equal(image.mask, seen)
    assert (image.mask & ~true).any() or (seen & ~image.mask).any()
    assert (image.mask & seen).sum() > 0.8 * (image.mask | seen).sum()
    assert (image.depth.metres[image.mask] > 0).all()


@pytest.mark.parametrize("model", FOREIGN)
def test_what_is_scored_is_the_truth_whatever_the_mask_says(model: CameraModel) -> None:
    case = make_case("drill", drill(), 1, 0, model)
    assert not np.array_equal(case.mask, case.scored)
    assert len(case.cloud) == case.scored.sum()
    assert (case.depth.metres[case.mask | case.scored] > 0).all()


def test_a_silhouette_before_a_far_background_loses_pixels() -> None:
    top = 0.61
    true = true_square(1.4 - top)
    inner = true_square(1.4 - top + 0.15)
    share = {
        model: np.mean(
            [(image_of(on_a_pole(), model, 1.4, seed).depth.metres[true & ~inner] == 0).mean() for seed in range(3)]
        )
        for model in (CameraModel.WINDOW, CameraModel.KINECT)
    }
    assert 0.1 < share[CameraModel.WINDOW] < 0.5
    assert share[CameraModel.KINECT] < 0.02


def test_ridges_are_rounded() -> None:
    """A window of 9 px, 0.5 x 9 / 580 rad to either side, sees a ridge of 90 deg a quarter of it deeper."""
    edge_up = rotation_from_vector([np.pi / 4, 0, 0])
    ridge = edge_up @ np.array([0.0, 0.1, 0.2])
    world = World([Body(box(0.4, 0.2, 0.2), Pose.of(edge_up, [0, -ridge[1], 0]))], FLOOR)
    height = ridge[2] + 0.9
    profiles = {
        model: np.mean([_across(world, model, height, seed) for seed in range(4)], axis=0)
        for model in (CameraModel.WINDOW, CameraModel.KINECT)
    }
    expected = 9 / 4 * 0.9 / 580
    rounding = {model: profile[0] - profile[10:15].mean() for model, profile in profiles.items()}
    assert rounding[CameraModel.WINDOW] == pytest.approx(expected, abs=0.001)
    assert rounding[CameraModel.KINECT] == pytest.approx(0.0, abs=0.0005)


def _across(world: World, model: CameraModel, height: float, seed: int) -> NDArray[Any]:
    """(20,), m: mean residual by the distance from the ridge, px; it is 0.9 m away, along the image's middle row."""
    image = image_of(world, model, height, seed)
    v = np.arange(480) - CAMERA.cy
    slope = np.abs(v) / CAMERA.fy
    true = 0.9 / (1 - slope)
    columns = image.depth.metres[:, 270:370].astype(np.float64)
    error = np.where(columns > 0, columns - true[:, None], np.nan)
    rows = np.rint(np.abs(v) - 0.5).astype(int)
    return np.array([np.nanmean(error[rows == distance]) for distance in range(20)])


@pytest.mark.parametrize(("model", "correlated"), [("window", True), ("stereo", True), ("kinect", False)])
def test_neighbours_err_alike_where_windows_are_matched(model: str, correlated: bool) -> None:
    """What is left after the mean over 4 x 4 px: of independent errors a quarter."""
    left = []
    for seed in range(3):
        values = residual(CameraModel(model), seed)
        values = np.nan_to_num(values - np.nanmean(values))
        left.append(values.reshape(60, 4, 80, 4).mean(axis=(1, 3)).std() / values.std())
    assert (min(left) > 0.6) if correlated else (max(left) < 0.3)


@pytest.mark.parametrize("model", FOREIGN)
def test_noise_grows_with_the_square_of_the_depth(model: CameraModel) -> None:
    near, far = (np.mean([np.nanstd(residual(model, seed, height)) for seed in range(4)]) for height in (0.7, 1.4))
    assert far / near == pytest.approx(4.0, rel=0.25)


def test_a_camera_is_off_as_a_whole_by_less_than_a_centimetre_and_never_twice_alike() -> None:
    biases = [np.nanmean(residual(CameraModel.WINDOW, seed)) for seed in range(8)]
    assert 0.0005 < np.std(biases) < 0.005
    assert np.abs(biases).max() < 0.01


def test_random_cameras_are_of_all_kinds_and_none_twice() -> None:
    cameras = [realise(CameraModel.RANDOM, np.random.default_rng(seed)) for seed in range(30)]
    assert len({repr(camera) for camera in cameras}) == 30
    matched = [camera for camera in cameras if isinstance(camera, WindowCamera)]
    assert any(isinstance(camera, Kinect) for camera in cameras)
    assert min(camera.errors.steps for camera in matched) == 8
    assert max(camera.errors.steps for camera in matched) == 32
    assert np.ptp([camera.window.size for camera in matched]) > 6
    again = realise(CameraModel.RANDOM, np.random.default_rng(3))
    assert again == cameras[3]


@pytest.mark.parametrize("seed", range(6))
def test_a_random_camera_sees_most_of_an_object(seed: int) -> None:
    case = make_case("drill", drill(), 0, seed, CameraModel.RANDOM)
    assert (case.mask & case.scored).sum() > 0.6 * case.scored.sum()
    depth = case.depth.metres[case.mask & case.scored]
    assert 0.7 < np.median(depth) < 1.1


@pytest.mark.parametrize("scale", [0.5, 1.5, 12.0, 200.0])
def test_smooth_fields_have_unit_variance_and_the_stated_scale(scale: float) -> None:
    fields = np.array([smooth_field(np.random.default_rng(seed), (40, 60), scale) for seed in range(300)])
    assert fields[:, ::13, ::13].std() == pytest.approx(1.0, abs=0.06)
    lag = max(1, round(scale))
    if lag < 60:
        correlation = (fields[:, :, :-lag] * fields[:, :, lag:]).mean()
        expected = np.exp(-((lag / (2 * scale)) ** 2)) if scale >= 1 else 0.0
        assert correlation == pytest.approx(expected, abs=0.08)


def test_blocks_are_the_camera_s_own_pixels() -> None:
    field = block_field(np.random.default_rng(0), (20, 30), 2.0)
    np.testing.assert_array_equal(field[::2], field[1::2])
    assert len(np.unique(field)) == 150
