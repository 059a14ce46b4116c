"""What two sessions can tell of a knock, and the page's intervals."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.camera_calibration_text import interval
from experiments.camera_knock_bound import FALSE_ALARMS, bound_shift, bound_turn


def test_no_knock_is_told_as_often_as_false_alarms_are_allowed() -> None:
    bound = bound_shift(1e-9, 0.001, 6)
    assert [bound.known, bound.learned, bound.known_6, bound.learned_6] == pytest.approx([FALSE_ALARMS] * 4, abs=1e-3)


def test_the_bound_is_the_power_of_the_test_in_a_simulation() -> None:
    rng = np.random.default_rng(0)
    std = np.hypot(0.002, 0.001)
    before, after = (rng.normal(size=(100_000, count, 3)) * std for count in (6, 2))
    after[..., 0] += 0.01
    off = after.mean(axis=1) - before.mean(axis=1)
    told = (off**2).sum(axis=1) / (std**2 * (1 / 6 + 1 / 2)) > 12.838  # chi-square of 3, 1 in 200
    assert told.mean() == pytest.approx(bound_shift(0.01, 0.001, 6).known, abs=0.005)


def test_what_must_be_learned_is_told_less_often() -> None:
    bound = bound_turn(np.radians(2), np.radians(0.3), 6)
    assert bound.learned_6 < bound.learned < bound.known
    assert bound.learned_6 < bound.known_6 < bound.known
    assert bound_turn(np.radians(2), np.radians(0.3), 60).learned > bound.learned


@pytest.mark.parametrize(("share", "text"), [(0.0, "0 (0 to 31)"), (0.5, "50 (19 to 81)"), (1.0, "100 (69 to 100)")])
def test_intervals_are_clopper_and_pearsons(share: float, text: str) -> None:
    assert interval(share, 10) == text
