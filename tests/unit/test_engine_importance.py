"""Importance sampling finds the moments of a density that differs much from its proposals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_registrar.engines.solvers.importance import Mode, estimate_moments

from pretouch.geometry import Array


@settings(max_examples=20, deadline=None)
@given(st.floats(0.1, 1.0), st.integers(0, 2**16))
def test_a_density_far_narrower_than_its_proposal_is_found(width: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.standard_normal((6, 6)))[0]
    std = width * rng.uniform(0.5, 1.0, 6)
    covariance = (turn * std**2) @ turn.T
    centre = 0.5 * rng.uniform(-1, 1, 6)
    information = np.linalg.inv(covariance)

    def energy(xs: Array) -> Array:
        apart = xs - centre
        return np.asarray(0.5 * (apart @ information * apart).sum(axis=1))

    mean, found = estimate_moments(energy, [Mode(np.zeros(6), np.eye(6), 1.0)])
    whitened = turn.T @ (mean - centre) / std
    assert np.abs(whitened).max() < 0.7
    spread = np.sqrt(np.diag(turn.T @ found @ turn)) / std
    assert (spread > 0.6).all()
    assert (spread < 1.7).all()


def test_both_modes_count() -> None:
    places = np.array([[1.0, 0, 0, 0, 0, 0], [-1.0, 0, 0, 0, 0, 0]])

    def energy(xs: Array) -> Array:
        squared = ((xs[:, None] - places) ** 2).sum(axis=2)
        return np.asarray(-np.log(np.exp(-0.5 * squared / 0.01).sum(axis=1) + 1e-300))

    mean, covariance = estimate_moments(energy, [Mode(place, 0.02 * np.eye(6), 0.5) for place in places])
    assert mean[0] == pytest.approx(0.0, abs=0.2)
    assert covariance[0, 0] == pytest.approx(1.01, abs=0.1)
    assert covariance[1, 1] == pytest.approx(0.01, rel=0.5)
