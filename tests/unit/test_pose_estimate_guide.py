"""The code of the guide to pose estimates does what the guide says."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.priors import covariances, means
from hypothesis import given
from hypothesis import strategies as st

from pretouch.geometry import Array, Pose, rotation_from_vector, vector_from_rotation

GUIDE = Path(__file__).parents[2] / "docs/how-to/refine-a-pose-estimate.md"
CLOUD = np.array([(x, y, z) for x in (0.41, 0.49) for y in (-0.03, 0.03) for z in (0.0, 0.05)])


@pytest.fixture(scope="module")
def guide() -> dict[str, Any]:
    names: dict[str, Any] = {}
    for block in re.findall(r"```python\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL):
        exec(block, names)
    return names


@given(means, means, covariances, st.integers(0, 5))
def test_a_small_error_of_the_estimated_pose_is_that_of_the_prior(
    guide: dict[str, Any], estimated: Pose, between: Pose, covariance: Array, k: int
) -> None:
    """An error along an axis of the estimator's covariance has the same probability under the prior."""
    seen = between @ estimated
    if np.linalg.norm(vector_from_rotation(between.rotation)) > 0.7:
        return
    prior = guide["prior_of"](estimated, covariance, seen, CLOUD)
    assert prior.mean.is_close(estimated @ seen.inverse(), 1e-6)
    error = 1e-3 * np.linalg.cholesky(covariance)[:, k]
    true_rotation = rotation_from_vector(error[:3]) @ estimated.rotation
    truth = Pose.of(true_rotation, estimated.translation + error[3:]) @ seen.inverse()
    centroid = CLOUD.mean(axis=0)
    turn = vector_from_rotation(truth.rotation @ prior.mean.rotation.T)
    apart = np.concatenate([turn, truth.apply(centroid) - prior.mean.apply(centroid)])
    assert apart @ np.linalg.solve(prior.covariance, apart) == pytest.approx(1e-6, rel=0.05)


def test_ros_writes_translation_first_in_the_axes_of_its_frame(guide: dict[str, Any]) -> None:
    quarter = rotation_from_vector((0, 0, np.pi / 2))
    got = guide["from_ros"](np.diag([1e-6, 4e-6, 9e-6, 1e-4, 4e-4, 9e-4]).ravel(), quarter)
    np.testing.assert_allclose(got, np.diag([4e-4, 1e-4, 9e-4, 4e-6, 1e-6, 9e-6]), atol=1e-18)
