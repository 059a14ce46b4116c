"""The scans to choose from: pieces of perimeters, lines across the object, and what lies beside it."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.scenes import KINECT, Box, World
from pretouch_orchestrator.planning.candidates import PIECES, CandidatePath, plan_nearby_paths, plan_object_paths
from pretouch_orchestrator.planning.coverage import CoveragePredictor, find_scanned
from pretouch_orchestrator.planning.path import PathPlanner
from pretouch_orchestrator.planning.surroundings import BEYOND
from scipy.spatial import KDTree

from pretouch.estimate import from_prior
from pretouch.geometry import Array
from pretouch.prior import Prior
from pretouch.rectangle import RotatedRectangle
from pretouch.scene import SCAN_MARGIN, Scene
from pretouch.session import Region, ScanSettings
from pretouch.tof import Scan, Sensor

RANGE_MAX = 0.1


def seen(*boxes: Box, margin: float = 0.2) -> Scene:
    return World(boxes).scene(KINECT, np.random.default_rng(0)).cropped(margin)[0]


def planner_of(scene: Scene, prior: Prior, beyond: float = SCAN_MARGIN) -> PathPlanner:
    return PathPlanner(scene, from_prior(prior, scene.cloud), ScanSettings(), beyond)


def regions_of(scene: Scene) -> list[Region]:
    u0, v0, u1, v1 = scene.bounds()
    middle, size = ((u0 + u1) / 2, (v0 + v1) / 2), (0.7 * (u1 - u0), 0.8 * (v1 - v0))
    return [Region(f"region-{k}", RotatedRectangle(*middle, *size, 0.4 * k), 0.5, 0.01) for k in (1, 2)]


def planned(scene: Scene, pieces: tuple[float, ...], closed: tuple[str, ...] = ()) -> list[CandidatePath]:
    return plan_object_paths(planner_of(scene, Prior()), regions_of(scene), pieces, closed)


def places_of(candidate: CandidatePath, span: tuple[float, float]) -> Array:
    path = candidate.path.between(*span)
    times = np.linspace(path.t[0], path.t[-1], 40)
    return np.asarray(path.at(times)[:, :2, 3])


def test_pieces_are_parts_of_their_path_that_cover_it_at_every_length() -> None:
    for candidate in planned(seen(Box.standing((0.1, 0.08, 0.05))), PIECES):
        duration = candidate.path.duration
        assert candidate.spans[0] == (0.0, duration)
        assert all(0 <= start < end <= duration for start, end in candidate.spans)
        for length in PIECES:
            pieces = [s for s in candidate.spans[1:] if s[1] - s[0] == pytest.approx(length / 0.05, rel=0.01)]
            if length > 0.8 * candidate.path.length:
                assert not pieces
                continue
            ends = np.array(pieces)
            assert ends[0, 0] == 0.0
            assert ends[-1, 1] == pytest.approx(duration)
            assert (ends[1:, 0] <= ends[:-1, 1] - 0.49 * length / 0.05).all()


def test_without_pieces_there_are_whole_perimeters_or_their_beginnings() -> None:
    candidates = planned(seen(Box.standing((0.1, 0.08, 0.05))), ())
    assert [candidate.id for candidate in candidates] == ["region-1", "region-2"]
    for candidate in candidates:
        assert candidate.region_id == candidate.id
        assert candidate.spans[0] == (0.0, candidate.path.duration)
        assert all(start == 0.0 for start, _ in candidate.spans)


def test_lines_lead_across_the_whole_object_and_follow_no_region() -> None:
    scene = seen(Box.standing((0.12, 0.06, 0.04), yaw=0.4))
    cloud = KDTree(scene.cloud[:, :2])
    lines = [candidate for candidate in planned(scene, PIECES) if candidate.id.startswith("line-")]
    assert len(lines) == 8
    for line in lines:
        assert line.region_id is None
        places = places_of(line, line.spans[0])
        along, away = places[-1] - places[0], places[1:-1] - places[0]
        np.testing.assert_allclose(away[:, 0] * along[1] - away[:, 1] * along[0], 0, atol=1e-6)
        distances, _ = cloud.query(places)
        assert distances[[0, -1]] == pytest.approx(SCAN_MARGIN, abs=0.012)
        assert (distances < 0.005).mean() > 0.3


def test_a_closed_path_is_left_out() -> None:
    scene = seen(Box.standing((0.1, 0.08, 0.05)))
    ids = [candidate.id for candidate in planned(scene, PIECES, ("region-1", "line-3"))]
    assert "region-2" in ids
    assert not {"region-1", "line-3"} & set(ids)


def test_nearby_paths_are_short_lie_beside_the_object_and_see_from_where_they_must_stay() -> None:
    tower = Box.standing((0.04, 0.04, 0.22))
    scene = seen(tower, margin=0.25)
    planner = planner_of(scene, Prior(), BEYOND)
    nearby = plan_nearby_paths(scene, planner, RANGE_MAX)
    assert nearby
    table = KDTree(scene.organised[(scene.depth.metres > 0) & ~scene.mask][:, :2])
    for candidate in nearby:
        assert candidate.region_id is None
        assert candidate.id.startswith("nearby-")
        places = places_of(candidate, candidate.spans[0])
        assert candidate.path.length < 0.08
        assert np.linalg.norm(places, axis=1).min() > 0.02
        assert np.linalg.norm(places, axis=1).max() < BEYOND + 0.1
        assert table.query(places)[0].max() < 0.01  # the table was seen there
        assert candidate.path.base_T_tip[:, 2, 3].max() < RANGE_MAX
    some = nearby[0].id
    assert some not in [candidate.id for candidate in plan_nearby_paths(scene, planner, RANGE_MAX, (some,))]


def test_where_nothing_can_be_seen_from_a_safe_height_there_is_no_nearby_path() -> None:
    scene = seen(Box.standing((0.04, 0.04, 0.22)))
    assert plan_nearby_paths(scene, planner_of(scene, Prior(0.05, 0.2), BEYOND), RANGE_MAX) == []


def test_nothing_unknown_is_within_reach_of_a_nearby_path() -> None:
    scene = seen(Box.standing((0.05, 0.05, 0.03)), margin=0.12)
    planner = planner_of(scene, Prior(), BEYOND)
    h, w = scene.depth.metres.shape
    nearby = plan_nearby_paths(scene, planner, RANGE_MAX)
    assert nearby
    for candidate in nearby:
        for place in places_of(candidate, candidate.spans[0]):
            around = place + planner.reach * np.array([(np.cos(a), np.sin(a)) for a in np.linspace(0, 6.2, 12)])
            ground = np.column_stack([around, np.zeros(12)])
            u, v = scene.camera.project(scene.base_T_camera.inverse().apply(ground)).T
            assert (u > -2).all()
            assert (v > -2).all()
            assert (u < w + 1).all()
            assert (v < h + 1).all()


def test_the_predicted_coverage_of_pieces_is_that_of_their_paths_and_grows_with_them() -> None:
    scene = seen(Box.standing((0.1, 0.08, 0.05)))
    (candidate, *_) = planned(scene, PIECES)
    base_R_tip = candidate.path.base_T_tip[0, :3, :3]
    predictor = CoveragePredictor(scene.cloud, [], Sensor(), base_R_tip)
    shares = predictor.predict_fractions(candidate.path, candidate.spans)
    assert shares[0] == shares.max() > 0
    for share, span in zip(shares, candidate.spans, strict=True):
        (alone,) = predictor.predict_fractions(candidate.path.between(*span), [(0.0, span[1] - span[0])])
        assert share == pytest.approx(alone, abs=0.02)
    points = scene.cloud[:: len(scene.cloud) // 60]
    scanned = Scan.of_points(points, (0.0, 0.0, -1.0))
    before = CoveragePredictor(scene.cloud, [scanned], Sensor(), base_R_tip)
    already = find_scanned(scene.cloud, [scanned]).mean()
    assert before.predict_fractions(candidate.path, candidate.spans).min() >= already - 0.03
