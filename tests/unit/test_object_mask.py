"""A client's mask is evidence: what the depth image contradicts is left out, and a mask of no object is refused."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.scenes import Box, View, World
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pretouch_orchestrator.perception.segmentation import Found, find_object

from pretouch.camera import DepthImage
from pretouch.errors import InvalidInput

UNIT = 0.0001
BOX = Box.standing((0.09, 0.07, 0.06), (0.02, -0.03), 0.4)
VIEW = View()
IMAGE, MASK = World((BOX,)).depth(VIEW, np.random.default_rng(0))
VALUES = np.round(IMAGE.metres / UNIT).astype(np.uint16)
INSIDE = np.argwhere(MASK)


def found(values: NDArray[np.uint16] = VALUES, mask: NDArray[np.bool_] = MASK) -> Found:
    return find_object(DepthImage.from_values(values, UNIT), VIEW.camera, VIEW.base_T_camera, None, mask)


CLEAN = found()


def test_a_good_mask_stays_as_it_is() -> None:
    assert CLEAN.warnings == ()
    assert CLEAN.scene.mask.sum() >= 0.98 * MASK.sum()


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, len(INSIDE) - 1), st.sampled_from([65535, 65534, 30000, 12000, 500])), max_size=8)
)
def test_specks_and_codes_for_no_data_are_no_part_of_the_object(specks: list[tuple[int, int]]) -> None:
    values = VALUES.copy()
    for place, value in specks:
        values[tuple(INSIDE[place])] = value
    scene = found(values).scene
    assert scene.mask.sum() >= CLEAN.scene.mask.sum() - 9 * len(specks)
    np.testing.assert_allclose(scene.cloud.min(axis=0), CLEAN.scene.cloud.min(axis=0), atol=0.006)
    np.testing.assert_allclose(scene.cloud.max(axis=0), CLEAN.scene.cloud.max(axis=0), atol=0.006)


def test_the_floor_and_a_wall_behind_the_table_are_no_part_of_the_object() -> None:
    values, mask = VALUES.copy(), MASK.copy()
    values[:60] = 16000  # a wall above the table's edge
    mask[40:60, 100:130] = True
    values[100:103, 10:13] = 30000  # the floor
    mask[100:103, 10:13] = True
    answer = found(values, mask)
    assert not (answer.scene.mask & ~MASK).any()
    assert [warning.code for warning in answer.warnings] == ["mask-background"]


def test_parts_that_something_in_front_separates_belong_to_the_object() -> None:
    bar = Box.standing((0.02, 0.012, 0.3), (-0.12, -0.03))
    image, _ = World((BOX, bar)).depth(VIEW)
    front = image.metres < IMAGE.metres - 0.02
    mask = MASK & ~front
    assert 0.1 < (MASK & front).sum() / MASK.sum() < 0.6
    answer = found(np.round(image.metres / UNIT).astype(np.uint16), mask)
    assert answer.scene.mask.sum() >= 0.95 * mask.sum()


def seen_through(share: float) -> NDArray[np.uint16]:
    """The table is seen through the box, but for the part farthest to the right."""
    bare, _ = World((Box.standing((0.01, 0.01, 0.01), (5.0, 5.0)),)).depth(VIEW, np.random.default_rng(1))
    right = np.indices(MASK.shape)[1] > np.quantile(INSIDE[:, 1], share)
    return np.where(MASK & ~right, np.round(bare.metres / UNIT), VALUES).astype(np.uint16)


@pytest.mark.parametrize(
    ("values", "mask", "message"),
    [
        (seen_through(1.0), MASK, "Nothing in the mask rises above the table"),
        (VALUES, np.roll(MASK, 90, axis=1), "Nothing in the mask rises above the table"),
        (VALUES, ~MASK, "looks inverted"),
        (VALUES, np.ones_like(MASK), "the mask covers 100%"),
    ],
    ids=["glass", "beside", "inverted", "everything"],
)
def test_a_mask_of_no_object_is_refused_and_told_the_median_depth(
    values: NDArray[np.uint16], mask: NDArray[np.bool_], message: str
) -> None:
    with pytest.raises(InvalidInput, match=message) as caught:
        found(values, mask)
    assert "The median depth is 0.8" in caught.value.detail
    assert "with depth_scale 0.0001" in caught.value.detail


def test_a_glass_of_which_a_little_is_seen_is_a_warning() -> None:
    (warning,) = found(seen_through(0.75)).warnings
    assert warning.code == "mask-table"
    assert "transparent" in warning.remedy
