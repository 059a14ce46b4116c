"""NARF beside Debian's PCL, where it is installed, on depth images of a simulated Kinect."""

import numpy as np
import pytest
from pretouch_detector.proposals.narf import SUPPORT

from benchmarks.narf import AGREES, Agreement, agreement, views
from benchmarks.narf_oracle import Missing, build

IMAGES = 20
MARGIN = 0.015


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> list[Agreement]:
    try:
        program = build(tmp_path_factory.mktemp("narf"))
    except Missing as missing:
        pytest.skip(str(missing))
    return agreement([(name, scene.cropped(MARGIN)[0]) for name, scene in views(IMAGES, None)], SUPPORT, program)


def test_borders_are_those_of_pcl(rows: list[Agreement]) -> None:
    assert len(rows) == IMAGES
    assert max(row.scores for row in rows) <= 1e-5
    assert sum(row.classes for row in rows) == 0


def test_the_complete_interest_image_is_that_of_pcl(rows: list[Agreement]) -> None:
    pixels = sum(row.pixels for row in rows)
    assert sum(row.apart for row in rows) <= 1e-4 * pixels
    assert np.median([row.interest for row in rows]) <= AGREES
    assert sum(row.sparse_apart for row in rows) > 0.1 * pixels  # PCL's default is another image


def test_keypoints_and_descriptors_are_those_of_pcl(rows: list[Agreement]) -> None:
    theirs = sum(row.keypoints for row in rows)
    assert theirs > 5 * IMAGES
    assert sum(row.shared for row in rows) >= 0.99 * theirs
    assert sum(row.ours for row in rows) <= 1.01 * theirs
    assert max(row.descriptors for row in rows) <= AGREES
