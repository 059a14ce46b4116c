"""How much wider than normal a prediction is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pretouch_orchestrator.calibration import widening
from pretouch_orchestrator.calibration.widening import widen

CHI2_95 = 12.592


def test_few_sessions_are_wider_than_many() -> None:
    factors = [widen([1.0] * count) for count in (0, 2, 5, 20, 90)]
    assert factors == sorted(factors, reverse=True)
    assert factors[-1] < 1.1


@pytest.mark.parametrize("seen", [0, 1, 8])
def test_the_region_holds_95_percent_of_what_cameras_are_taken_to_do(seen: int) -> None:
    """Cameras drawn from the prior: what is learned of each keeps the region of its next session right."""
    rng = np.random.default_rng(seen)
    shares = np.exp(widening._LOG_PRIOR)
    kinds = rng.choice(len(shares), 4000, p=shares / shares.sum())
    freedom, scale = widening._FREEDOMS[kinds, None], widening._SCALES[kinds, None]
    norms = scale * rng.f(6, freedom, (4000, seen + 1))
    factors = np.array([widen(row[:-1]) for row in norms]) if seen else widen([])
    held = 6 * norms[:, -1] <= CHI2_95 * factors
    assert held.mean() == pytest.approx(0.95, abs=0.012)


def test_surprising_sessions_widen_and_unsurprising_ones_never_narrow() -> None:
    assert widen([3.0] * 9) > 2.0 * widen([1.0] * 9)
    assert 1.0 <= widen([0.1] * 9) <= widen([])


def test_one_wild_session_in_ten_widens_less_than_ten_wild_ones() -> None:
    tame, tailed, wild = (widen(values) for values in ([1.0] * 10, [1.0] * 9 + [15.0], [15.0] * 10))
    assert 1.2 * tame < tailed < 0.3 * wild


@given(st.lists(st.floats(0, 1e12), max_size=100))
def test_wrong_sessions_widen_by_a_bounded_factor(surprises: list[float]) -> None:
    assert 1.0 <= widen(surprises) <= 15.0
