"""Table that the object hides from the camera, and a finger finds there, does not contradict the pose.

Most scans run on beyond the object, whose far side the camera cannot see: where it stands to the left, what lies to the
right in the shadow. Every return from there costs at the truth; together they must not outweigh all others.
"""

import numpy as np
import pytest
from helpers.registration_probe import WORLD, line
from helpers.scenes import KINECT
from pretouch_registrar.registration import Registrar, Settings

from pretouch.geometry import Array
from pretouch.tof import Sensor

REGISTRAR = Registrar()
SETTINGS = Settings()
INTO_THE_SHADOW = ((-0.09, -0.02), (0.09, 0.03))
NOT_SO_FAR = ((-0.09, -0.02), (0.053, 0.0197))


def answered(ends: tuple[tuple[float, float], tuple[float, float]], seed: int) -> tuple[Array, Array]:
    """Correction (6,) and covariance (6, 6) after one scan where the camera was right."""
    scene = WORLD.scene(KINECT, np.random.default_rng(seed)).cropped(0.1)[0]
    scan = WORLD.scanned(line(*ends), Sensor(), np.random.default_rng(seed)).beams(Sensor())
    solution = REGISTRAR.solve(scene, [scan], SETTINGS)
    return solution.x, solution.covariance


@pytest.mark.parametrize("seed", [5, 6, 7])
@pytest.mark.parametrize("ends", [INTO_THE_SHADOW, NOT_SO_FAR], ids=["into the shadow", "not so far"])
def test_one_scan_over_a_box_leaves_the_truth_within_its_region(
    ends: tuple[tuple[float, float], tuple[float, float]], seed: int
) -> None:
    x, covariance = answered(ends, seed)
    assert x @ np.linalg.solve(covariance, x) < 16.8  # the 99 % region
    assert np.linalg.norm(x[3:]) < 0.015
