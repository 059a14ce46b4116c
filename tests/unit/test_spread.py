"""Greedy suppression: the better of two regions that overlap much stays, decided exactly."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_detector.proposals.spread import MAX_OVERLAP, spread

from pretouch.rectangle import RotatedRectangle


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    p, q = (shapely.Polygon(RotatedRectangle(*row).corners()) for row in (a, b))
    return float(p.intersection(q).area / p.union(q).area)


def one_by_one(ranked: np.ndarray, count: int) -> list[int]:
    kept: list[int] = []
    for k, row in enumerate(ranked):
        if len(kept) < count and all(overlap(ranked[j], row) <= MAX_OVERLAP for j in kept):
            kept.append(k)
    return kept


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 12), room=st.floats(1.0, 40.0))
def test_the_same_as_one_by_one(seed: int, count: int, room: float) -> None:
    rng = np.random.default_rng(seed)
    low, high = (0, 0, 10, 10, -np.pi / 2), (room, room, 25, 25, np.pi / 2)
    ranked = rng.uniform(low, high, (30, 5))
    assert spread(ranked, count) == one_by_one(ranked, count)


@pytest.mark.parametrize(("shift", "kept"), [(2.4, [0]), (2.6, [0, 1])])
def test_the_limit_is_a_share_of_the_union(shift: float, kept: list[int]) -> None:
    turned = 0.5
    second = (shift * np.cos(turned), shift * np.sin(turned), 10, 4, turned)
    assert spread(np.array([(0, 0, 10, 4, turned), second]), 5) == kept


def test_a_rectangle_named_by_its_other_sides_is_the_same() -> None:
    assert spread(np.array([(5.0, 5, 10, 4, -np.pi / 2), (5, 5, 4, 10, 0)]), 5) == [0]


def test_nothing_of_nothing() -> None:
    assert spread(np.zeros((0, 5)), 5) == []
