"""Reliability: shares against levels, and pictures of them."""

from pathlib import Path

import numpy as np
import pytest
from helpers.made_runs import KEY, run_of
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from pretouch_simulation.evaluation_rows import Run
from pretouch_simulation.reliability import (
    LEVELS,
    average_in_bins,
    binomial_band,
    compute_observed_shares,
    save_expected_errors,
    save_reliability,
)


def test_honest_estimates_lie_within_the_band_and_others_do_not() -> None:
    whitened = np.random.default_rng(3).standard_normal((400, 6))
    distances2 = (whitened**2).sum(axis=1)
    low, high = binomial_band(400)
    honest = compute_observed_shares(distances2)
    assert ((low <= honest) & (honest <= high)).mean() > 0.9
    overconfident = compute_observed_shares(4 * distances2)
    assert (overconfident[4:] < low[4:]).all()
    assert (compute_observed_shares(distances2 / 4)[4:15] > high[4:15]).all()


@given(st.integers(1, 500))
def test_the_band_holds_the_level_and_narrows(n: int) -> None:
    low, high = binomial_band(n)
    assert (low <= LEVELS + 1 / n).all()
    assert (high >= LEVELS - 1 / n).all()
    nearer_low, nearer_high = binomial_band(100 * n)
    assert (nearer_high - nearer_low).mean() < (high - low).mean()


def test_the_limit_of_the_95_percent_region_is_the_contracts() -> None:
    assert compute_observed_shares([12.58, 12.60], [0.95]) == [0.5]


@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=40))
def test_bins_keep_the_mean_and_the_order(pairs: list[tuple[float, float]]) -> None:
    expected, achieved = zip(*pairs, strict=True)
    x, y = average_in_bins(expected, achieved, 5)
    assert (np.diff(x) >= 0).all()
    assert min(achieved) - 1e-12 <= y.min()
    assert y.max() <= max(achieved) + 1e-12
    assert len(x) == min(5, len(pairs))


def runs(engine: str, sensor: str) -> list[Run]:
    rng = np.random.default_rng(1)
    key = KEY._replace(engine=engine, sensor=sensor)
    found = [
        run_of(key._replace(view=view), *rng.uniform(0.002, 0.01, 2), distances2=rng.chisquare(6, 2).tolist())
        for view in range(12)
    ]
    return [*found, Run(**key._replace(view=99)._asdict(), initial_error=None, problem="broken")]


@pytest.mark.parametrize("save", [save_reliability, save_expected_errors])
def test_pictures_have_a_panel_for_each_engine_and_sensor(save: object, tmp_path: Path) -> None:
    assert callable(save)
    setups = [(engine, sensor) for engine in ("paper", "point_to_plane") for sensor in ("ideal", "vl6180x")]
    save([run for setup in setups for run in runs(*setup)], (1, 2), "all", tmp_path / "four.png")
    save(runs("point_to_plane", "ideal"), (1, 2), "one", tmp_path / "one.png")
    with Image.open(tmp_path / "four.png") as four, Image.open(tmp_path / "one.png") as one:
        assert four.width > 1.8 * one.width
        assert four.height > 1.8 * one.height
        assert len(four.getcolors() or []) > 8
