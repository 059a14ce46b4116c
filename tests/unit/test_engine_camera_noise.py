"""A camera's noise is measured on the table in its image: that of a pixel, and that common to a patch."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import KINECT, Box, World
from pretouch_registrar.engines.camera_noise import (
    PATCH,
    UNKNOWN_PATCH,
    UNKNOWN_PIXEL,
    CameraNoise,
    measure_camera_noise,
)

from pretouch.camera import DepthImage
from pretouch.geometry import Array, Plane, Pose
from pretouch.scene import Scene

UNKNOWN = CameraNoise(UNKNOWN_PIXEL, UNKNOWN_PATCH)


@pytest.fixture(scope="module")
def clean() -> Scene:
    boxes = (Box.standing((0.10, 0.06, 0.05), (0.0, 0.0), 0.4), Box.standing((0.05, 0.05, 0.08), (0.12, -0.1)))
    return World(boxes).scene(KINECT).cropped(0.15)[0]


def raised(scene: Scene, heights: Array) -> Scene:
    """The scene with each pixel (h, w) moved along its sight line until it is so much higher, m, above the table."""
    h, w = heights.shape
    v, u = np.indices((h, w))
    rays = scene.camera.back_project(np.stack([u, v], axis=-1), np.ones((h, w)))
    rise = scene.base_T_camera.rotate(rays) @ scene.table.normal
    depth = scene.depth.metres + heights / rise
    return replace(scene, depth=DepthImage(np.where(scene.depth.metres > 0, depth, 0).astype(np.float32)))


def white(scene: Scene, std: float, seed: int) -> Array:
    return np.random.default_rng(seed).normal(0, std, scene.depth.metres.shape)


def of_patches(scene: Scene, std: float, seed: int) -> Array:
    """(h, w), m: one error for all pixels of a PATCH of the table."""
    cells = np.floor(scene.organised @ scene.table.frame().rotation[:, :2] / PATCH).astype(int)
    cells -= cells.min(axis=(0, 1))
    errors = np.random.default_rng(seed).normal(0, std, cells.max(axis=(0, 1)) + 1)
    return np.asarray(errors[cells[..., 0], cells[..., 1]])


def pixels_of_a_patch(scene: Scene) -> float:
    """How many there are about the middle of the image's table."""
    table = (scene.depth.metres > 0) & ~scene.mask & (np.abs(scene.table.height(scene.organised)) < 1e-3)
    cells = np.floor(scene.organised[table] @ scene.table.frame().rotation[:, :2] / PATCH)
    return float(np.median(np.unique(cells, axis=0, return_counts=True)[1]))


@pytest.mark.parametrize("std", [0.0008, 0.002, 0.0035])
@pytest.mark.parametrize("seed", [0, 1])
def test_noise_of_single_pixels_averages_out_over_a_patch(clean: Scene, std: float, seed: int) -> None:
    found = measure_camera_noise(raised(clean, white(clean, std, seed)))
    assert found.pixel == pytest.approx(std, rel=0.25)
    averaged = std / np.sqrt(pixels_of_a_patch(clean))
    assert found.patch == pytest.approx(max(averaged, 0.0002), rel=0.3)


@pytest.mark.parametrize("std", [0.0008, 0.0015, 0.0022])
@pytest.mark.parametrize("seed", [0, 1])
def test_an_error_that_patches_share_is_measured_under_noise_of_their_pixels(
    clean: Scene, std: float, seed: int
) -> None:
    found = measure_camera_noise(raised(clean, of_patches(clean, std, seed) + white(clean, 0.001, seed)))
    assert found.patch == pytest.approx(std, rel=0.25)
    assert found.pixel == pytest.approx(np.hypot(std, 0.001), rel=0.25)


def test_a_table_that_was_put_a_little_wrong_is_not_taken_for_noise(clean: Scene) -> None:
    noisy = raised(clean, white(clean, 0.001, 3))
    tilted = replace(noisy, table=clean.table.moved(Pose.from_rotation_vector((0.008, -0.005, 0.0), (0, 0, 0.002))))
    np.testing.assert_allclose(measure_camera_noise(tilted), measure_camera_noise(noisy), rtol=0.1)


def test_what_lies_flat_on_the_table_is_not_taken_for_noise(clean: Scene) -> None:
    noise = white(clean, 0.001, 4)
    place = clean.organised
    sheet = (np.abs(place[..., 0]) < 0.03) & (np.abs(place[..., 1] - 0.1) < 0.03) & ~clean.mask
    assert sheet.sum() > 300
    found = measure_camera_noise(raised(clean, noise + np.where(sheet, 0.006, 0.0)))
    np.testing.assert_allclose(found, measure_camera_noise(raised(clean, noise)), rtol=0.3)


def test_where_no_table_is_seen_a_usual_cameras_noise_is_assumed(clean: Scene) -> None:
    blind = replace(clean, depth=DepthImage(np.where(clean.mask, clean.depth.metres, 0).astype(np.float32)))
    assert measure_camera_noise(blind) == UNKNOWN
    far_below = replace(clean, table=Plane(clean.table.normal, clean.table.offset - 0.1))
    assert measure_camera_noise(far_below) == UNKNOWN
    strip = clean.mask.copy()
    strip[0] = True
    few = replace(clean, depth=DepthImage(np.where(strip, clean.depth.metres, 0).astype(np.float32)))
    assert measure_camera_noise(few) == UNKNOWN


def test_noise_is_measured_the_same_wherever_base_is(clean: Scene) -> None:
    noisy = raised(clean, of_patches(clean, 0.001, 5) + white(clean, 0.001, 5))
    elsewhere = Pose.from_rotation_vector((0.3, -0.2, 1.1), (0.7, -0.4, 0.9))
    moved = replace(noisy, base_T_camera=elsewhere @ noisy.base_T_camera, table=noisy.table.moved(elsewhere))
    there, here = measure_camera_noise(moved), measure_camera_noise(noisy)
    assert there.pixel == pytest.approx(here.pixel, rel=1e-3)
    assert there.patch == pytest.approx(here.patch, rel=0.3)
