"""A campaign's hidden errors: as large as a single session's, shared by all of its objects, knocked as stated."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.made_frame import write_mesh
from pretouch_simulation.campaign_world import HEADING, Campaign, CampaignSettings, Change, campaigns
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.finger import FingerModel
from pretouch_simulation.objects import box, can
from pretouch_simulation.protocol import CAMERA_DISTANCE, OFFSET_ROTATION, OFFSET_TRANSLATION, PLACE, Case

from pretouch.errors import InvalidInput
from pretouch.geometry import Pose, vector_from_rotation

SAME = CampaignSettings(3, residual=Change())
AIM = PLACE + np.array([0.0, 0.0, 0.05])
AHEAD = np.array([0.0, 0.0, float(np.mean(CAMERA_DISTANCE))])


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("meshes")
    for name, mesh in (("box", box()), ("can", can())):
        write_mesh(folder / f"{name}.obj", mesh)
    return sorted(folder.iterdir())


def cases(settings: CampaignSettings, meshes: list[Path], number: int = 0) -> list[Case]:
    campaign = Campaign(settings, tuple(meshes), number, seed=0)
    return [campaign.case(position, CameraModel.KINECT) for position in range(1, settings.objects + 1)]


def turn_of(pose: Pose) -> float:
    return float(np.linalg.norm(vector_from_rotation(pose.rotation)))


def test_the_error_at_the_object_is_as_large_as_a_single_sessions(meshes: list[Path]) -> None:
    shifts, turns = [], []
    for campaign in campaigns(SAME, meshes, 200, seed=0):
        camera_side, base_side = campaign.sides
        believed = base_side.inverse() @ campaign._home @ camera_side.inverse()
        whole = campaign._home @ believed.inverse()
        shifts.append(whole.apply(AIM) - AIM)
        turns.append(vector_from_rotation(whole.rotation))
    assert np.abs(shifts).max() <= OFFSET_TRANSLATION
    np.testing.assert_allclose(np.std(shifts, axis=0), OFFSET_TRANSLATION / np.sqrt(3), rtol=0.15)
    np.testing.assert_allclose(np.std(turns, axis=0), OFFSET_ROTATION / np.sqrt(3), rtol=0.15)


def test_a_fixed_camera_is_wrong_by_the_same_at_every_object(meshes: list[Path]) -> None:
    first, *others = cases(SAME, meshes)
    for case in others:
        assert case.base_T_camera.is_close(first.base_T_camera)
        assert case.truth.is_close(first.truth)


def test_a_moving_camera_is_wrong_by_both_sides(meshes: list[Path]) -> None:
    camera_side, base_side = Campaign(SAME, tuple(meshes), 0, seed=0).sides
    seen = cases(replace(SAME, moving=True), meshes)
    for case in seen:
        believed = case.base_T_camera
        assert case.truth.is_close(base_side @ believed @ camera_side @ believed.inverse())
    apart = [turn_of(case.base_T_camera.inverse() @ seen[0].base_T_camera) for case in seen[1:]]
    assert min(apart) > 0.05
    assert max(apart) < 2 * HEADING + 0.2


def test_what_differs_from_session_to_session_has_the_stated_size() -> None:
    residual = CampaignSettings(1).residual
    rng = np.random.default_rng(0)
    drawn = [residual.draw_normal(AIM, rng) for _ in range(2000)]
    shifts = np.array([pose.apply(AIM) - AIM for pose in drawn])
    turns = np.array([vector_from_rotation(pose.rotation) for pose in drawn])
    np.testing.assert_allclose(shifts.std(axis=0), 0.002, rtol=0.06)
    np.testing.assert_allclose(turns.std(axis=0), np.radians(0.4), rtol=0.06)


def test_a_knock_moves_the_camera_by_its_size_from_its_position_on(meshes: list[Path]) -> None:
    knock = Change(0.01, float(np.radians(2.0)))
    campaign = Campaign(replace(SAME, knock_at=2, knock=knock), tuple(meshes), 0, seed=0)
    assert [campaign.is_knocked(position) for position in (1, 2, 3)] == [False, True, True]
    before, after, later = (campaign.camera_side(position) for position in (1, 2, 3))
    change = before.inverse() @ after
    assert turn_of(change) == pytest.approx(knock.rotation)
    assert np.linalg.norm(change.apply(AHEAD) - AHEAD) == pytest.approx(knock.translation)
    assert later.is_close(after)


def test_a_drift_goes_on_from_object_to_object(meshes: list[Path]) -> None:
    campaign = Campaign(replace(SAME, drift=Change(0.001, 0.001)), tuple(meshes), 0, seed=0)
    sides = [campaign.camera_side(position) for position in (1, 2, 3)]
    steps = [a.inverse() @ b for a, b in itertools.pairwise(sides)]
    assert sides[0].is_close(campaign.sides[0])
    assert all(0 < np.linalg.norm(step.apply(AHEAD) - AHEAD) < 0.006 for step in steps)
    assert not steps[0].is_close(steps[1])


def test_a_campaign_is_fixed_by_its_seed_and_number(meshes: list[Path]) -> None:
    (one, *_), (again, *_), (other, *_) = (cases(CampaignSettings(1), meshes, number) for number in (0, 0, 1))
    np.testing.assert_array_equal(one.depth.metres, again.depth.metres)
    np.testing.assert_array_equal(one.truth.matrix, again.truth.matrix)
    assert not one.truth.is_close(other.truth)
    assert one.view != other.view


def test_a_campaign_has_one_finger_and_goes_through_the_meshes_again(meshes: list[Path]) -> None:
    campaign = Campaign(SAME, tuple(meshes), 0, seed=0)
    one, again = (campaign.finger(FingerModel.RANDOM).sensor for _ in range(2))
    assert (one.range_std, one.beam_half_angle) == (again.range_std, again.beam_half_angle)
    assert {path.stem for path in campaign.paths[:2]} == {"box", "can"}
    assert campaign.paths[2] == campaign.paths[0]


@pytest.mark.parametrize(("translation", "rotation"), [(-0.001, 0.0), (2.0, 0.0), (0.0, 4.0), (float("nan"), 0.0)])
def test_a_change_out_of_its_limits_is_refused(translation: float, rotation: float) -> None:
    with pytest.raises(InvalidInput, match="out of its limits"):
        Change(translation, rotation)
