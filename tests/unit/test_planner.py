"""The next scan is the one that tells most a second, or the proposer's favourite, among those that see something."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pretouch_orchestrator.planning.candidates import CandidatePath
from pretouch_orchestrator.planning.planner import MIN_GAIN, MIN_RETURNS, Need, Option, choose

from pretouch.scan_prediction import Prediction
from pretouch.session import Planner
from pretouch.trajectory import APPROACH_SECONDS, Trajectory

PRESENT = 0.02
PATH = Trajectory(np.array([0.0, 10.0]), np.tile(np.eye(4), (2, 1, 1)))


def option(name: str, expected_error: float, seconds: float = 1.0, confidence: float = 0.5) -> Option:
    candidate = CandidatePath(name, name, PATH, ((0.0, seconds),))
    return Option(candidate, (0.0, seconds), Prediction(expected_error, 1.0), confidence)


def need(log_ratio: float = 10.0, scans: int = 10) -> Need:
    return Need(PRESENT, log_ratio, scans)


options = st.lists(
    st.builds(option, st.uuids().map(str), st.floats(0.0005, 0.018), st.floats(0.1, 10.0), st.floats(0, 1)),
    min_size=1,
    max_size=12,
)


@given(options)
def test_of_equally_long_scans_the_one_that_tells_most_is_chosen(some: list[Option]) -> None:
    alike = [option(each.candidate.id, each.prediction.expected_error) for each in some]
    best = choose(alike, Planner.INFORMATION, need())
    assert best is not None
    assert best.prediction.expected_error == pytest.approx(min(each.prediction.expected_error for each in alike))


@given(options, st.floats(0.1, 5.0), st.integers(1, 10))
def test_no_scan_tells_more_a_second_unless_it_is_too_small_a_step(
    some: list[Option], log_ratio: float, scans: int
) -> None:
    best = choose(some, Planner.INFORMATION, need(log_ratio, scans))
    assert best is not None

    def gain(each: Option) -> float:
        return float(np.log(PRESENT / each.prediction.expected_error))

    largest = max(map(gain, some))
    assert gain(best) >= min(log_ratio / scans, 0.8 * largest) - 1e-9
    for each in some:
        if gain(each) >= gain(best):
            assert gain(each) / each.seconds <= gain(best) / best.seconds + 1e-9


@given(options)
def test_by_confidence_the_most_confident_is_chosen(some: list[Option]) -> None:
    best = choose(some, Planner.CONFIDENCE, need())
    assert best is not None
    assert best.confidence == max(each.confidence for each in some)


@pytest.mark.parametrize("planner", list(Planner))
def test_without_an_option_none_is_chosen(planner: Planner) -> None:
    assert choose([], planner, need()) is None


def test_two_short_scans_beat_a_long_one_that_tells_as_much_only_if_the_ways_to_them_are_short() -> None:
    whole = option("whole", PRESENT * np.exp(-1.0), seconds=6.0)
    part = option("part", PRESENT * np.exp(-0.5), seconds=1.0)
    assert choose([whole, part], Planner.INFORMATION, need(log_ratio=1.0)) is part
    nearly_whole = option("part", PRESENT * np.exp(-0.5), seconds=6.0 - APPROACH_SECONDS)
    assert choose([whole, nearly_whole], Planner.INFORMATION, need(log_ratio=1.0)) is whole


def test_the_fewer_scans_are_left_the_more_each_has_to_tell() -> None:
    enough, quick = option("enough", PRESENT * np.exp(-0.9), 6.0), option("quick", PRESENT * np.exp(-0.3), 0.5)
    assert choose([enough, quick], Planner.INFORMATION, need(log_ratio=0.85, scans=3)) is quick
    assert choose([enough, quick], Planner.INFORMATION, need(log_ratio=0.85, scans=1)) is enough
    nearly = option("nearly", PRESENT * np.exp(-0.75), 0.5)  # 0.8 of the best is as good as the best, and quicker
    assert choose([enough, nearly], Planner.INFORMATION, need(log_ratio=0.85, scans=1)) is nearly


def test_a_scan_that_tells_next_to_nothing_is_not_worth_the_way() -> None:
    assert choose([option("idle", PRESENT * np.exp(-0.9 * MIN_GAIN))], Planner.INFORMATION, need()) is None
    assert choose([option("some", PRESENT * np.exp(-1.1 * MIN_GAIN))], Planner.INFORMATION, need()) is not None
    nearly_there = need(log_ratio=0.5 * MIN_GAIN, scans=2)
    assert choose([option("idle", PRESENT * np.exp(-0.9 * MIN_GAIN))], Planner.INFORMATION, nearly_there) is not None


def test_a_scan_is_visible_if_enough_of_its_samples_are_expected_to_return() -> None:
    seen = option("seen", 0.01)
    for returns, visible in ((MIN_RETURNS - 0.01, False), (MIN_RETURNS, True)):
        each = Option(seen.candidate, seen.span, Prediction(0.01, returns), 0.5)
        assert each.visible is visible


def test_equal_confidences_keep_the_proposers_order_and_the_longest_beginning_comes_first() -> None:
    first, second = option("first", 0.01), option("second", 0.001)
    assert choose([first, second], Planner.CONFIDENCE, need()) is first
    half, whole = option("one", 0.01, seconds=2.0), option("one", 0.01, seconds=4.0)
    assert choose([half, whole], Planner.CONFIDENCE, need()) is whole
