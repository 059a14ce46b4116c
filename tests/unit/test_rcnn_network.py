"""The two-stage network as it is served, with graphs whose answers are known."""

from collections.abc import Sequence

import numpy as np
import pytest
from pretouch_detector.model.anchors import anchors
from pretouch_detector.model.encoding import CHANNELS, SIZE, encode
from pretouch_detector.model.rcnn_network import TwoStageNetwork
from pretouch_detector.overlap import common_areas
from pretouch_detector.proposals.random import allowed
from pretouch_detector.proposals.two_stage import regions
from scenes import Box, View, World, looking

from pretouch.camera import Camera
from pretouch.estimate import Prior, from_prior

WORLD = World((Box.standing((0.10, 0.06, 0.05), yaw=0.4),))
SLIM = World((Box.standing((0.02, 0.20, 0.02)),))
UNMOVED = np.array([0, 0, 0, 0, 1, 0], np.float32)


class FirstStage:
    """All anchors are as good as each other, and stay where they are."""

    def run(self, names: Sequence[str], inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
        assert inputs["image"].shape == (1, len(CHANNELS), SIZE, SIZE)
        n = len(anchors())
        answers = {"features": inputs["image"], "objectness": np.zeros(n), "deltas": np.tile(UNMOVED, (n, 1))}
        return [answers[name] for name in names]


class SecondStage:
    """The further left, the better."""

    def run(self, names: Sequence[str], inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
        x = inputs["rectangles"][:, 0]
        assert inputs["rectangles"].dtype == np.float32
        logs = np.column_stack([np.log(0.005) + x, np.zeros_like(x)])
        answers = {"score": x, "deltas": np.tile(UNMOVED, (len(x), 1)), "log_error": logs}
        return [answers[name] for name in names]


NETWORK = TwoStageNetwork(FirstStage(), SecondStage())


@pytest.mark.parametrize(
    ("world", "view"),
    [
        (WORLD, View()),
        (SLIM, View()),
        (WORLD, View(camera=Camera(131.0, 131.0, 79.5, 59.5), width=160, height=120)),
        (WORLD, View(looking((0.0, 0.47, 0.02)))),
    ],
    ids=["plain", "slim", "small image", "at the border"],
)
@pytest.mark.parametrize("count", [1, 10])
def test_regions_are_allowed_differ_and_come_by_their_errors(world: World, view: View, count: int) -> None:
    scene = world.scene(view)
    found = regions(NETWORK, scene, count)
    assert len(found) == count
    rectangles = np.array([region.rectangle.as_list() for region in found])
    assert allowed(rectangles, scene).all()
    errors = NETWORK.errors(encode(scene), rectangles)
    assert (np.diff(errors) >= -1e-9).all()
    expected = np.clip(1 - errors / from_prior(Prior(), scene.cloud).expected_error, 0, 1)
    np.testing.assert_allclose([region.confidence for region in found], expected, atol=1e-5)
    areas = rectangles[:, 2] * rectangles[:, 3]
    for k in range(1, count):
        common = common_areas(rectangles[k], rectangles[:k])
        assert (common / (areas[k] + areas[:k] - common) <= 0.6 + 1e-6).all()


def test_the_best_of_the_image_is_on_its_better_side() -> None:
    scene = WORLD.scene()
    u0, _, u1, _ = scene.bounds()
    assert regions(NETWORK, scene, 1)[0].rectangle.x < u0 + 0.25 * (u1 - u0)


def test_errors_are_told_of_any_rectangle() -> None:
    scene = WORLD.scene()
    encoding = encode(scene)
    x = np.array([-0.5, 0.0, 0.5])
    given = encoding.pixels(np.column_stack([x, 0 * x, 0 * x + 0.4, 0 * x + 0.4, 0 * x]))
    np.testing.assert_allclose(NETWORK.errors(encoding, given), 0.005 * np.exp(x), rtol=1e-5)
