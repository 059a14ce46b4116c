"""Augmentation transforms a view together with its rectangles, and keeps their errors."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from pretouch_detector.model.encoding import CHANNELS, SIZE
from pretouch_detector.training.augment import augment
from pretouch_detector.training.targets import Targets

from pretouch.rectangle import RotatedRectangle

HEIGHT, ACROSS, OBJECT, SEEN, LOG_SIZE = (
    CHANNELS.index(name) for name in ("height", "across", "object", "seen", "size")
)
PIXEL = 2 / SIZE
_STEPS = (np.arange(SIZE) + 0.5) * PIXEL - 1
PIXELS = np.stack(np.meshgrid(_STEPS, _STEPS), axis=-1)


def drawn(rectangle: RotatedRectangle) -> Targets:
    """A view whose object is the inside of a rectangle, in units of the square."""
    inside = rectangle.distance(PIXELS) < 0
    image = np.zeros((len(CHANNELS), SIZE, SIZE), np.float32)
    image[SEEN] = 1
    image[OBJECT], image[HEIGHT], image[ACROSS] = inside, 0.8 * inside, PIXELS[..., 0]
    errors = np.array([[0.01, np.nan, 0.02]], np.float32)
    return Targets(image, np.array([rectangle.as_list()], np.float32), np.full(1, 0.007, np.float32), errors)


@given(
    st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(0.3, 0.6), st.floats(0.15, 0.25), st.floats(-1.5, 1.5),
    st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_the_rectangle_stays_on_what_it_was_on(x: float, y: float, w: float, h: float, theta: float, seed: int) -> None:
    before = drawn(RotatedRectangle(x, y, w, h, theta))
    after = augment(before, np.random.default_rng(seed))
    distance = RotatedRectangle(*after.rectangles[0].tolist()).distance(PIXELS)
    on, seen = after.image[OBJECT] > 0, after.image[SEEN] > 0
    assert on[(distance < -2 * PIXEL) & seen].all()
    assert not on[distance > 2 * PIXEL].any()
    np.testing.assert_array_equal(after.errors, before.errors)
    zoom = np.sqrt(np.prod(after.rectangles[0, 2:4]) / np.prod(before.rectangles[0, 2:4]))
    np.testing.assert_allclose(after.image[LOG_SIZE], -np.log(zoom), atol=1e-5)


def test_a_mirrored_view_has_its_places_mirrored() -> None:
    before = drawn(RotatedRectangle(0.0, 0.0, 0.5, 0.2, 0.3))
    turns = []
    for seed in range(40):
        after = augment(before, np.random.default_rng(seed))
        seen = after.image[SEEN] > 0
        slope = np.polyfit(np.nonzero(seen)[1], after.image[ACROSS][seen], 1)[0]
        assert slope > 0  # mirrored or not, right is right
        turns.append(float(after.rectangles[0, 4]))
    assert min(turns) < -0.1 < 0.1 < max(turns)


def test_unseen_pixels_hold_nothing() -> None:
    after = augment(drawn(RotatedRectangle(0.0, 0.0, 0.5, 0.4, 0.3)), np.random.default_rng(3))
    lost = after.image[SEEN] == 0
    assert lost.any()
    assert not after.image[:LOG_SIZE, lost].any()
    assert np.ptp(after.image[LOG_SIZE]) == 0
