"""Beams that may have hit the object under the prior are kept; those far away and repeated ones are not."""

from __future__ import annotations

import numpy as np
from helpers.scenes import Box, World
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_registrar.beam_selection import select_beams

from pretouch.geometry import Pose, rotation_from_vector
from pretouch.prior import Prior
from pretouch.tof import Scan, Sensor

WORLD = World((Box.standing((0.2, 0.06, 0.05), yaw=0.4),))
SCENE = WORLD.scene()
DOWN = np.array([0.0, 0.0, -1.0])
SIGMAS = st.tuples(*[st.floats(-3, 3)] * 6)


@settings(max_examples=60, deadline=None)
@given(SIGMAS, st.floats(1e-4, 0.05), st.floats(1e-3, 0.3))
def test_whatever_the_prior_allows_is_kept(sigmas: tuple[float, ...], translation: float, rotation: float) -> None:
    prior = Prior(translation, rotation)
    turn = rotation_from_vector(np.array(sigmas[:3]) * rotation)
    shift = np.array(sigmas[3:]) * translation
    truth = Pose.of(turn, SCENE.centroid + shift - turn @ SCENE.centroid)
    points = np.unique(truth.apply(SCENE.cloud[::7]), axis=0)
    beams = Scan(points - 0.03 * DOWN, np.broadcast_to(DOWN, points.shape), np.full(len(points), 0.03))
    assert select_beams(SCENE, beams, prior, Sensor()) is beams
    misses = Scan(beams.origins, beams.directions, np.full(len(points), np.nan))
    assert select_beams(SCENE, misses, prior, Sensor()) is misses


@settings(max_examples=60, deadline=None)
@given(st.floats(0, 2 * np.pi), st.floats(0.35, 50.0), st.booleans())
def test_what_is_far_away_is_not(angle: float, distance: float, returned: bool) -> None:
    place = SCENE.centroid + distance * np.array([np.cos(angle), np.sin(angle), 0.0])
    ends = place + np.linspace(-0.02, 0.02, 9)[:, None] * (0, 0, 1)
    scan = Scan(ends, np.broadcast_to(DOWN, ends.shape), np.full(9, 0.03 if returned else np.nan))
    assert len(select_beams(SCENE, scan, Prior(), Sensor())) == 0


@settings(max_examples=40, deadline=None)
@given(st.lists(st.integers(0, 5), min_size=1, max_size=40))
def test_a_beam_counts_once_and_the_order_stays(chosen: list[int]) -> None:
    ends = SCENE.cloud[np.array(chosen)]
    ranges = np.where(np.array(chosen) % 2 == 0, 0.02, np.nan)
    kept = select_beams(SCENE, Scan(ends, np.broadcast_to(DOWN, ends.shape), ranges), Prior(), Sensor())
    first = list(dict.fromkeys(chosen))
    np.testing.assert_array_equal(kept.origins, SCENE.cloud[np.array(first)])
    np.testing.assert_array_equal(kept.returned, np.array(first) % 2 == 0)
