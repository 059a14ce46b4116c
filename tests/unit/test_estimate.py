"""An estimate validates its modes and its fit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from pretouch.errors import InvalidInput, Malformed
from pretouch.estimate import Estimate, Mode, from_prior
from pretouch.geometry import Pose
from pretouch.prior import Prior

HERE = Pose.from_rotation_vector((0.01, 0.02, 0.03), (0.004, -0.005, 0.006))
THERE = Pose.from_rotation_vector((0.01, 0.02, -0.6), (0.004, 0.02, 0.006))


def estimate(**changes: Any) -> Estimate:
    return Estimate(HERE, np.zeros(3), np.eye(6), 0.01, 0.02, **changes)


def test_before_the_first_scan_there_is_one_mode_that_fits() -> None:
    before = from_prior(Prior(), np.eye(3))
    (mode,) = before.modes
    assert mode.weight == 1
    assert mode.base_T_correction.is_close(Pose.identity())
    assert (before.fit, before.sensor_problem) == (1.0, "")


def test_an_estimate_keeps_the_modes_it_is_given_in_their_order() -> None:
    modes = (Mode(HERE, 0.7), Mode(THERE, 0.3))
    assert estimate(modes=modes).modes == modes


@pytest.mark.parametrize(
    ("modes", "words"),
    [
        ([(HERE, 0.7), (THERE, 0.2)], "sum to 0.9"),
        ([(HERE, 0.7), (THERE, 0.4)], "sum to 1.1"),
        ([(THERE, 0.7), (HERE, 0.3)], "is not estimate.base_T_correction"),
    ],
)
def test_modes_that_cannot_be_are_refused(modes: list[tuple[Pose, float]], words: str) -> None:
    with pytest.raises(InvalidInput, match=words) as caught:
        estimate(modes=tuple(Mode(pose, weight) for pose, weight in modes))
    assert caught.value.remedy


@pytest.mark.parametrize(("weight", "error"), [(0.0, InvalidInput), (1.1, InvalidInput), (math.nan, Malformed)])
def test_a_weight_is_a_probability(weight: float, error: type[InvalidInput]) -> None:
    with pytest.raises(error, match=r"modes\.weight"):
        Mode(HERE, weight)


@pytest.mark.parametrize(
    ("fit", "error"), [(-1e-9, InvalidInput), (1.001, InvalidInput), (math.nan, Malformed), (math.inf, Malformed)]
)
def test_a_fit_is_a_p_value(fit: float, error: type[InvalidInput]) -> None:
    with pytest.raises(error, match=r"estimate\.fit"):
        estimate(fit=fit)


@pytest.mark.parametrize("fit", [0.0, 1e-300, 1.0])
def test_the_ends_of_a_fit_are_allowed(fit: float) -> None:
    assert estimate(fit=fit).fit == fit
