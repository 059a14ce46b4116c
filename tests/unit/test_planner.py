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


@given(candidates, st.sampled_from(Planner), st.floats(0, 60))
def test_the_best_that_fits_is_chosen(some: list[Candidate], planner: Planner, seconds: float) -> None:
    fitting = [c for c in some if c.path.duration <= seconds]
    best = choose(some, planner, PRESENT, lambda c: c.path.duration <= seconds)
    if not fitting:
        assert best is None
        return
    assert best in fitting
    if planner is Planner.CONFIDENCE:
        assert best.region.confidence == max(c.region.confidence for c in fitting)
    else:
        assert best.region.expected_error <= min(c.region.expected_error for c in fitting) + 1.001e-4


def test_among_equals_the_gain_per_robot_second_decides() -> None:
    slow, quick, worse = candidate("slow", 0.00500, seconds=20), candidate("quick", 0.00505), candidate("worse", 0.0052)
    best = choose([slow, quick, worse], Planner.INFORMATION, PRESENT, lambda c: True)
    assert best is quick


def test_equal_confidences_keep_the_proposers_order() -> None:
    first, second = candidate("first", 0.01), candidate("second", 0.001)
    assert choose([first, second], Planner.CONFIDENCE, PRESENT, lambda c: True) is first
