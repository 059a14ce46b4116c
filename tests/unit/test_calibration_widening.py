"""How much wider than normal a prediction is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pretouch_orchestrator.calibration.widening import widen


def test_few_sessions_are_wider_than_many() -> None:
    factors = [widen([1.0] * count) for count in (0, 2, 5, 20, 90)]
    assert factors == sorted(factors, reverse=True)
    assert factors[-1] == pytest.approx(1.0, abs=0.05)


def test_the_region_holds_95_percent_of_a_t_distribution_of_six_axes() -> None:
    rng = np.random.default_rng(0)
    freedom = 15  # after two predicted sessions
    drawn = rng.normal(size=(200_000, 6)) / np.sqrt(rng.chisquare(freedom, 200_000) / freedom)[:, None]
    assert ((drawn**2).sum(axis=1) / widen([1.0, 1.0]) <= 12.592).mean() == pytest.approx(0.95, abs=0.003)


def test_surprising_sessions_widen_and_unsurprising_ones_never_narrow() -> None:
    assert widen([3.0] * 9) == pytest.approx(2.5 * widen([1.0] * 9))
    assert widen([0.1] * 9) == widen([1.0] * 9)


@given(st.lists(st.floats(0, 1e12), max_size=100))
def test_wrong_sessions_widen_by_a_bounded_factor(surprises: list[float]) -> None:
    assert 1.0 <= widen(surprises) <= 6.0 * widen([])
