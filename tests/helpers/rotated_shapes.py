"""Rotated rectangles for tests, and their overlap as shapely has it."""

import numpy as np
import shapely
from hypothesis import strategies as st

from pretouch.rectangle import RotatedRectangle

# Round numbers often, so that edges coincide, corners touch edges, and rectangles are equal.
_place = st.one_of(st.integers(-4, 4).map(lambda k: k / 4), st.floats(-1, 1))
_side = st.one_of(st.integers(1, 6).map(lambda k: k / 4), st.floats(0.05, 1.5))
_theta = st.one_of(st.integers(-4, 3).map(lambda k: k * np.pi / 8), st.floats(-np.pi / 2, np.pi / 2 - 1e-9))
rectangles = st.tuples(_place, _place, _side, _side, _theta).map(np.array)


def several(least: int, most: int) -> st.SearchStrategy[np.ndarray]:
    """(n, 5) with least <= n <= most."""
    return st.lists(rectangles, min_size=least, max_size=most).map(lambda rows: np.array(rows).reshape(-1, 5))


def drawn(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 5) at random."""
    places, sides = rng.uniform(-1, 1, (count, 2)), rng.uniform(0.05, 1.5, (count, 2))
    return np.column_stack([places, sides, rng.uniform(-np.pi / 2, np.pi / 2, count)])


def shapely_overlap(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(n, m): intersection over union of the polygons."""
    a, b = (shapely.polygons([RotatedRectangle(*row).corners() for row in rows]) for rows in (first, second))
    common = shapely.area(shapely.intersection(a[:, None], b[None]))
    return np.asarray(common / (shapely.area(a)[:, None] + shapely.area(b)[None] - common))
