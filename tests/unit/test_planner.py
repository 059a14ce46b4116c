"""The next region is the one that tells most, or the proposer's favourite, among those that fit the budget."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from pretouch_orchestrator.planner import Candidate, choose

from pretouch.rectangle import RotatedRectangle
from pretouch.session import Planner, Region
from pretouch.trajectory import Trajectory

PRESENT = 0.02
RECTANGLE = RotatedRectangle(0, 0, 10, 10, 0)


def candidate(name: str, expected_error: float, confidence: float = 0.5, seconds: float = 5.0) -> Candidate:
    path = Trajectory(np.array([0.0, seconds]), np.tile(np.eye(4), (2, 1, 1)))
    return Candidate(Region(name, RECTANGLE, confidence, expected_error), path)


candidates = st.lists(
    st.builds(candidate, st.uuids().map(str), st.floats(0.0005, 0.02), st.floats(0, 1), st.floats(0.1, 60)), max_size=12
)


@given(candidates, st.sampled_from(Planner), st.floats(0.1, 60))
def test_one_that_fits_is_chosen_if_there_is_any(some: list[Candidate], planner: Planner, seconds: float) -> None:
    fitting = [c for c in some if c.path.duration <= seconds]
    best = choose(some, planner, PRESENT, lambda c: c.path.duration / seconds)
    if not fitting:
        assert best is None
        return
    assert best in fitting
    if planner is Planner.CONFIDENCE:
        assert best.region.confidence == max(c.region.confidence for c in fitting)


@given(candidates.filter(bool))
def test_at_equal_cost_the_one_that_tells_most_is_chosen(some: list[Candidate]) -> None:
    best = choose(some, Planner.INFORMATION, PRESENT, lambda c: 0.1)
    assert best is not None
    assert best.region.expected_error == min(c.region.expected_error for c in some)


def test_what_tells_a_little_less_for_much_less_of_the_budget_is_chosen() -> None:
    dear, cheap, idle = candidate("dear", 0.005, seconds=20), candidate("cheap", 0.006), candidate("idle", 0.0199)
    best = choose([dear, cheap, idle], Planner.INFORMATION, PRESENT, lambda c: c.path.duration / 30)
    assert best is cheap


def test_equal_confidences_keep_the_proposers_order() -> None:
    first, second = candidate("first", 0.01), candidate("second", 0.001)
    assert choose([first, second], Planner.CONFIDENCE, PRESENT, lambda c: 0.1) is first
