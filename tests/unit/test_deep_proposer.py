"""Proposer `deep`, with a network of known outputs."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from helpers import made_network
from helpers.scenes import KINECT, Box, View, World, looking
from pretouch_detector.model.weights import Network, Weights, load
from pretouch_detector.overlap import compute_intersection_over_union
from pretouch_detector.proposals import deep, propose
from pretouch_detector.proposals.information import predict_errors_after_scans
from pretouch_detector.proposals.random import AREA, LOG_ASPECT, MIN_OVERLAP, draw_rectangles
from pretouch_detector.suppression import MAX_OVERLAP

from pretouch.camera import Camera, DepthImage
from pretouch.errors import InvalidInput
from pretouch.estimate import from_prior
from pretouch.prior import Prior
from pretouch.scene import Scene
from pretouch.session import Proposer
from pretouch.tof import Sensor

WORLD = World((Box.standing((0.10, 0.06, 0.05), yaw=0.4),))
NARROW = View(camera=Camera(131.0, 131.0, 79.5, 59.5), width=160, height=120)
WIDE = View(camera=Camera(1400.0, 1400.0, 959.5, 539.5), width=1920, height=1080)
AT_THE_BORDER = View(looking((0.0, 0.47, 0.02)))


@pytest.fixture(autouse=True)
def network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Network:
    weights = Weights(made_network.write(tmp_path / "weights"))
    monkeypatch.setattr(deep, "WEIGHTS", weights)
    return weights.get_network()


def rows(scene: Scene, count: int = 20, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Rectangles (n, 5) and confidences (n,)."""
    regions = propose(scene, Proposer.DEEP, Sensor(), count, seed).regions
    return np.array([r.rectangle.as_list() for r in regions]), np.array([r.confidence for r in regions])


def check(scene: Scene, rectangles: np.ndarray) -> None:
    """The rules of Algorithm 1, and that no two are much the same."""
    u0, v0, u1, v1 = scene.bounds()
    bounding = np.array([(u0 + u1 - 1) / 2, (v0 + v1 - 1) / 2, u1 - u0, v1 - v0, 0.0])
    areas = rectangles[:, 2] * rectangles[:, 3] / (bounding[2] * bounding[3])
    assert ((areas >= AREA[0] - 1e-9) & (areas <= AREA[1] + 1e-9)).all()
    assert (np.abs(np.log(rectangles[:, 2] / rectangles[:, 3])) <= LOG_ASPECT + 1e-9).all()
    assert (2 * np.abs(rectangles[:, :2] - bounding[:2]) <= bounding[2:4] + 1e-9).all()
    for k, rectangle in enumerate(rectangles):
        assert compute_intersection_over_union(bounding, rectangle) >= MIN_OVERLAP - 1e-9
        assert all(compute_intersection_over_union(rectangle, other) <= MAX_OVERLAP + 1e-9 for other in rectangles[:k])


def test_the_regions_are_the_networks_best_of_many(network: Network) -> None:
    scene = WORLD.scene()
    rectangles, confidences = rows(scene)
    check(scene, rectangles)
    assert len(rectangles) == 20
    assert (np.diff(confidences) <= 0).all()
    errors = deep.predict_errors(network, scene, Sensor(), rectangles)
    np.testing.assert_allclose(confidences, 1 - errors / from_prior(Prior(), scene.cloud).expected_error)
    draws = deep.predict_errors(network, scene, Sensor(), draw_rectangles(scene, 200, np.random.default_rng(1)))
    assert (errors < np.median(draws)).all()
    assert errors[0] < np.quantile(draws, 0.02)


def test_a_network_without_a_word_of_its_own_leaves_the_ranking_of_stability(tmp_path: Path) -> None:
    silent = load(made_network.write(tmp_path / "silent", [0] * 5, bias=0.0, share=1.0), 1)
    scene = WORLD.scene()
    regions = deep.propose_with(silent, scene, Sensor(), 10, np.random.default_rng(0))
    rectangles = np.array([region.rectangle.as_list() for region in regions])
    analytic, _ = predict_errors_after_scans(scene, Sensor(), rectangles)
    assert (np.diff(analytic) > -1e-6).all()
    drawn_best = predict_errors_after_scans(scene, Sensor(), draw_rectangles(scene, 200, np.random.default_rng(0)))[
        0
    ].min()
    assert analytic[0] <= drawn_best + 1e-6


def test_the_same_request_gives_the_same_regions_whoever_asks_beside_it(tmp_path: Path) -> None:
    scene = WORLD.scene()
    expected = propose(scene, Proposer.DEEP, Sensor(), 20, 7)
    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(lambda seed: propose(scene, Proposer.DEEP, Sensor(), 20, seed), [7, 8, 7, 9, 7, 7]))
    assert [answer == expected for answer in answers] == [True, False, True, False, True, True]
    alone = load(tmp_path / "weights", 1)
    assert deep.propose_with(alone, scene, Sensor(), 20, np.random.default_rng(7)) == expected.regions


def test_a_confidence_is_a_share_however_bad_the_network_thinks_all_regions(tmp_path: Path) -> None:
    hopeless = load(made_network.write(tmp_path / "hopeless", bias=3.0), 1)
    regions = deep.propose_with(hopeless, WORLD.scene(), Sensor(), 5, np.random.default_rng(0))
    assert [region.confidence for region in regions] == [0.0] * 5


def test_a_smaller_count_takes_the_best(network: Network) -> None:
    many, few = rows(WORLD.scene(), 20)[0], rows(WORLD.scene(), 3)[0]
    np.testing.assert_array_equal(few, many[:3])


def test_the_image_far_around_the_object_does_not_matter() -> None:
    scene = WORLD.scene(KINECT, np.random.default_rng(3))
    view, (u0, v0) = scene.cropped(0.15)
    np.testing.assert_allclose(rows(view)[0] + (u0, v0, 0, 0, 0), rows(scene)[0])


@pytest.mark.parametrize("view", [NARROW, View(), KINECT, WIDE, AT_THE_BORDER])
def test_images_of_any_size_and_an_object_at_the_border(view: View) -> None:
    scene = WORLD.scene(view, np.random.default_rng(0))
    u0, v0, u1, v1 = scene.bounds()
    assert (view is AT_THE_BORDER) is (min(u0, v0, view.width - u1, view.height - v1) == 0)
    rectangles, confidences = rows(scene)
    check(scene, rectangles)
    assert len(rectangles) >= 10
    assert ((confidences >= 0) & (confidences <= 1)).all()


def test_stored_values_of_another_unit_give_the_same_regions() -> None:
    scene = WORLD.scene()
    regions = {}
    for unit in (0.001, 0.0001):  # m
        values = (np.rint(scene.depth.metres / 0.001) * round(0.001 / unit)).astype(np.uint16)
        depth = DepthImage.from_values(values, unit)
        regions[unit] = rows(Scene(depth, scene.camera, scene.base_T_camera, scene.mask, scene.table))[0]
    np.testing.assert_allclose(regions[0.001], regions[0.0001])


def test_an_object_of_the_fewest_pixels_has_regions_and_a_smaller_one_is_refused() -> None:
    scene = WORLD.scene()
    v, u = np.argwhere(scene.mask).mean(axis=0).astype(int)
    mask = np.zeros_like(scene.mask)
    mask[v : v + 5, u : u + 10] = True
    tiny = Scene(scene.depth, scene.camera, scene.base_T_camera, mask, scene.table)
    rectangles, _ = rows(tiny)
    check(tiny, rectangles)
    assert len(rectangles) >= 5
    mask[v, u] = False
    with pytest.raises(InvalidInput, match="49 pixels with depth"):
        Scene(scene.depth, scene.camera, scene.base_T_camera, mask, scene.table)


@pytest.mark.parametrize("hole", ["around", "inside"])
def test_missing_depth_does_not_matter(hole: str) -> None:
    scene = WORLD.scene()
    metres = np.where(scene.mask, scene.depth.metres, 0.0) if hole == "around" else scene.depth.metres.copy()
    if hole == "inside":
        v, u = np.argwhere(scene.mask).mean(axis=0).astype(int)
        metres[v - 3 : v + 3, u - 3 : u + 3] = np.nan
    rectangles, _ = rows(Scene(DepthImage(metres), scene.camera, scene.base_T_camera, scene.mask, scene.table))
    check(scene, rectangles)
