"""The next region is the most informative one, or the proposer's favourite, among those within the budget."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pretouch_orchestrator.planning.planner import Candidate, choose

from pretouch.rectangle import RotatedRectangle
from pretouch.session import Planner, Region
from pretouch.trajectory import Trajectory

PRESENT = 0.02
RECTANGLE = RotatedRectangle(0, 0, 10, 10, 0)
PATH = Trajectory(np.array([0.0, 1.0]), np.tile(np.eye(4), (2, 1, 1)))


def candidate(name: str, expected_error: float, confidence: float = 0.5, share: float = 0.1) -> Candidate:
    return Candidate(Region(name, RECTANGLE, confidence, expected_error), PATH, share)


candidates = st.lists(
    st.builds(candidate, st.uuids().map(str), st.floats(0.0005, 0.02), st.floats(0, 1)), min_size=1, max_size=12
)


@given(candidates)
def test_at_equal_cost_the_one_that_tells_most_is_chosen(some: list[Candidate]) -> None:
    best = choose(some, Planner.INFORMATION, PRESENT)
    assert best is not None
    assert best.region.expected_error == pytest.approx(min(c.region.expected_error for c in some))


@given(candidates)
def test_by_confidence_the_most_confident_is_chosen(some: list[Candidate]) -> None:
    best = choose(some, Planner.CONFIDENCE, PRESENT)
    assert best is not None
    assert best.region.confidence == max(c.region.confidence for c in some)


@pytest.mark.parametrize("planner", list(Planner))
def test_without_a_candidate_none_is_chosen(planner: Planner) -> None:
    assert choose([], planner, PRESENT) is None


def test_what_tells_a_little_less_for_much_less_of_the_budget_is_chosen() -> None:
    dear, cheap, idle = candidate("dear", 0.005, share=0.6), candidate("cheap", 0.006), candidate("idle", 0.0199)
    assert choose([dear, cheap, idle], Planner.INFORMATION, PRESENT) is cheap


def test_equal_confidences_keep_the_proposers_order() -> None:
    first, second = candidate("first", 0.01), candidate("second", 0.001)
    assert choose([first, second], Planner.CONFIDENCE, PRESENT) is first
