"""The same samples give the same estimate to the bit, in any order and on any number of threads."""

import os

import numpy as np
import pytest
from helpers.registration_probe import bits, session
from pretouch_registrar.registration import Registrar

HALF_ANGLE = float(np.radians(12.5))


@pytest.fixture(scope="module", params=[0.0, HALF_ANGLE], ids=["thin", "wide"])
def half_angle(request: pytest.FixtureRequest) -> float:
    return float(request.param)


@pytest.fixture(scope="module")
def expected(half_angle: float) -> str:
    """The answer to the whole session, bit by bit."""
    return bits(Registrar().register(*session(half_angle)))


def test_the_order_of_the_scans_does_not_matter(half_angle: float, expected: str) -> None:
    scene, scans, settings = session(half_angle)
    assert bits(Registrar().register(scene, [scans[k] for k in (2, 0, 1)], settings)) == expected


def test_an_answer_depends_on_nothing_that_was_asked_before(half_angle: float, expected: str) -> None:
    scene, scans, settings = session(half_angle)
    asked = Registrar()
    assert bits(asked.register(scene, scans[1:], settings)) != expected
    assert bits(asked.register(scene, scans, settings)) == expected
    assert bits(asked.register(scene, scans, settings)) == expected


@pytest.mark.parametrize("threads", [1, 3])
def test_an_answer_does_not_depend_on_the_number_of_threads(
    half_angle: float, expected: str, threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(threads)), raising=False)
    assert bits(Registrar().register(*session(half_angle))) == expected


def test_a_scan_sent_twice_counts_once(half_angle: float, expected: str) -> None:
    scene, scans, settings = session(half_angle)
    assert bits(Registrar().register(scene, [*scans, scans[1], scans[0]], settings)) == expected
