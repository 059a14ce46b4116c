"""Artefacts of a depth camera in mid-air are removed; what stands on something is kept."""

import numpy as np
from pretouch_orchestrator.perception.clusters import find_specks

FOCAL = 500.0


def scene() -> np.ndarray:
    return np.full((120, 160), 0.8, dtype=np.float32)


def test_a_speck_in_mid_air_is_found_and_nothing_else() -> None:
    depth = scene()
    depth[50:60, 70:82] = 0.5  # 1 cm x 1.2 cm
    expected = np.zeros(depth.shape, dtype=bool)
    expected[50:60, 70:82] = True
    np.testing.assert_array_equal(find_specks(depth, FOCAL), expected)


def test_a_larger_thing_before_the_table_and_a_place_without_depth_are_none() -> None:
    depth = scene()
    depth[50:80, 70:100] = 0.5  # 3 cm x 3 cm
    depth[10:14, 10:14] = 0.0
    assert not find_specks(depth, FOCAL).any()


def test_a_small_thing_that_its_neighbours_hold_up_is_none() -> None:
    depth = scene()
    depth[50:56, 70:76] = 0.785
    assert not find_specks(depth, FOCAL).any()
