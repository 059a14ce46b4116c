"""What anchors and proposals should become."""

import numpy as np
from pretouch_detector.model.anchors import anchors, decode
from pretouch_detector.overlap import overlap
from pretouch_detector.training.rcnn_targets import best_of, matched
from pretouch_detector.training.targets import ACHIEVED, FORESEEN
from rotated_shapes import shapely_overlap

NAN = np.nan


def errors_of(achieved: list[float], foreseen: list[float]) -> np.ndarray:
    errors = np.full((len(achieved), 3), NAN)
    errors[:, ACHIEVED], errors[:, FORESEEN] = achieved, foreseen
    return errors


def test_the_best_tenth_is_best_and_at_least_one() -> None:
    foreseen = np.random.default_rng(0).permutation(40) / 1000
    best = best_of(errors_of([NAN] * 40, foreseen.tolist()))
    assert sorted(foreseen[best]) == [0.0, 0.001, 0.002, 0.003]
    assert best_of(errors_of([0.3, 0.2, 0.4], [NAN] * 3)).tolist() == [1]


def test_what_is_known_of_more_rectangles_judges_and_unknown_is_never_best() -> None:
    assert best_of(errors_of([0.1, NAN, NAN], [0.3, 0.2, NAN])).tolist() == [1]
    assert best_of(errors_of([0.1, NAN, 0.3], [0.3, 0.2, NAN])).tolist() == [0]


def test_good_overlap_by_half_and_bad_by_less_than_three_tenths() -> None:
    best = np.array([[0.1, 0.2, 0.8, 0.5, 0.3], [-0.4, 0.0, 0.5, 0.6, -1.0]])
    some = anchors()[::7]
    found = matched(some, best, each_found=False)
    most = shapely_overlap(some, best).max(axis=1)
    assert (found.good == (most >= 0.5)).all()
    assert (found.bad == (most < 0.3)).all()
    assert found.good.any()
    assert found.bad.any()
    moved = decode(some, found.deltas)[found.good]
    np.testing.assert_allclose(overlap(moved, best).max(axis=1), 1, atol=1e-9)


def test_no_best_rectangle_goes_unlearned_by_the_anchors() -> None:
    best = np.array([[0.0, 0.0, 0.05, 0.05, 0.3]])  # far smaller than any anchor
    found = matched(anchors(), best, each_found=True)
    assert found.good.sum() == 1
    assert not (found.good & found.bad).any()
