"""A beam along earlier ones of which more missed than returned will miss too, unless it starts lower."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from pretouch_registrar.engines.registration_problem import Beams
from pretouch_registrar.known_misses import find_repeated_misses

from pretouch.geometry import Array

DOWN = np.array([[0.0, 0.0, -1.0]])


def beams_from(origins: Array, ranges: Array) -> Beams:
    """Straight down; NaN is a miss."""
    returned = np.isfinite(ranges)
    reach = np.where(returned, ranges, 0.0)
    directions = np.repeat(DOWN, len(origins), axis=0)
    return Beams(origins + reach[:, None] * directions, directions, returned, np.ones(len(origins)), reach)


@given(st.integers(0, 5), st.integers(0, 5), st.floats(-0.02, 0.05), st.floats(0.0, 0.01))
def test_only_a_beam_along_earlier_misses_and_no_lower_repeats_them(
    misses: int, returns: int, raised: float, aside: float
) -> None:
    earlier = beams_from(np.tile([0.0, 0.0, 0.15], (misses + returns, 1)), np.repeat([np.nan, 0.08], [misses, returns]))
    (repeats,) = find_repeated_misses(earlier, np.array([[aside, 0.0, 0.15 + raised]]), DOWN)
    if abs(aside - 0.004) > 1e-6 and abs(raised + 0.005) > 1e-6:
        assert repeats == (misses > returns and aside < 0.004 and raised > -0.005)


def test_a_beam_in_another_direction_repeats_nothing() -> None:
    earlier = beams_from(np.array([[0.0, 0.0, 0.15]]), np.array([np.nan]))
    slanted = np.array([[np.sin(0.2), 0.0, -np.cos(0.2)]])
    assert find_repeated_misses(earlier, np.array([[0.0, 0.0, 0.15]]), DOWN)[0]
    assert not find_repeated_misses(earlier, np.array([[0.0, 0.0, 0.15]]), slanted)[0]
