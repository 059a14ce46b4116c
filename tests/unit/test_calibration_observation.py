"""What a session says beyond its prior, and what a session may not be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.camera_sessions import STATED, camera_at, session, turned
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_orchestrator.calibration.model import Sides
from pretouch_orchestrator.calibration.observation import difference, remove_prior

from pretouch.errors import InvalidInput, Malformed
from pretouch.geometry import Pose
from pretouch.prior import PosePrior

CENTROID = np.array([0.1, 0.0, 0.05])


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_removing_the_prior_leaves_what_the_samples_said(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mixed = rng.normal(size=(6, 6)) * np.repeat([[0.02], [0.004]], 3, axis=0)
    prior = PosePrior(
        turned(rng.normal(size=3) * 0.003, rng.normal(size=3) * 0.001, CENTROID), mixed @ mixed.T + 0.25 * STATED
    )
    camera = camera_at(0.0)
    correction = turned(rng.normal(size=3) * 0.003, rng.normal(size=3) * 0.001, CENTROID)
    seen = session(0, camera, correction @ camera, CENTROID, prior)
    own = remove_prior(seen)
    off = difference(correction, seen.base_T_correction, CENTROID)
    assert len(own.values) >= 1
    assert np.allclose((own.values - own.rows @ off) / np.sqrt(own.variances), 0, atol=0.1)
    assert np.allclose(own.rows @ STATED @ own.rows.T, np.diag(own.variances), rtol=0.1, atol=0.1 * own.variances.max())


@pytest.mark.parametrize("name", ["covariance", "prior_covariance"])
def test_what_is_no_covariance_is_refused(name: str) -> None:
    seen = session(0, camera_at(0.0), camera_at(0.0), CENTROID)
    with pytest.raises(InvalidInput, match=name):
        replace(seen, **{name: -np.eye(6)})
    with pytest.raises(Malformed, match=name):
        replace(seen, **{name: np.full((6, 6), np.nan)})
    with pytest.raises(Malformed, match="at"):
        replace(seen, at=np.inf)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_jacobian_is_the_derivative(seed: int) -> None:
    rng = np.random.default_rng(seed)
    draws = [Pose.from_rotation_vector(rng.normal(size=3) * 0.1, rng.normal(size=3) * 0.02) for _ in range(2)]
    sides = Sides(*draws, rng.normal(size=3), rng.normal(size=3))
    camera, point = Pose.from_rotation_vector(rng.normal(size=3), rng.normal(size=3)), rng.normal(size=3)
    step = 1e-6
    changed = [sides.changed(step * axis).correction(camera) for axis in np.eye(12)]
    numeric = np.stack([difference(one, sides.correction(camera), point) / step for one in changed], axis=1)
    assert np.allclose(sides.jacobian(camera, point), numeric, atol=1e-4)
    undone = sides.changed(sides.change_to_nothing())
    assert undone.camera_T_camera.is_close(Pose.identity())
    assert undone.base_T_base.is_close(Pose.identity())
