"""Hand-eye calibration of the experiments: what went in without noise comes out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from experiments.hand_eye import Track, pair, read_track, solve
from pretouch.errors import InvalidInput, NotFound
from pretouch.geometry import Array, Pose


def _tracks(times: Array, hand: list[Pose], hand_T_camera: Pose, base_T_target: Pose) -> tuple[Track, Track]:
    seen = [(pose @ hand_T_camera).inverse() @ base_T_target for pose in hand]
    return _track(times, hand), _track(times, seen)


def _track(times: Array, poses: list[Pose]) -> Track:
    turns = Rotation.from_matrix(np.stack([pose.rotation for pose in poses]))
    return Track(times, turns, np.stack([pose.translation for pose in poses]))


def _draw(rng: np.random.Generator, turn: float = 1.0) -> Pose:
    return Pose.from_rotation_vector(turn * rng.normal(size=3), rng.normal(size=3) * 0.3)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_both_unknown_poses_are_recovered_from_pairs_without_noise(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hand_T_camera, base_T_target = _draw(rng), _draw(rng)
    hand = [_draw(rng) for _ in range(20)]
    found = solve(*_tracks(np.arange(20.0), hand, hand_T_camera, base_T_target))
    assert found[0].is_close(hand_T_camera, 1e-5)
    assert found[1].is_close(base_T_target, 1e-5)


def test_a_wrong_pair_does_not_carry_the_calibration_away() -> None:
    rng = np.random.default_rng(1)
    hand_T_camera, base_T_target = _draw(rng), _draw(rng)
    hand, camera = _tracks(np.arange(40.0), [_draw(rng) for _ in range(40)], hand_T_camera, base_T_target)
    camera.positions[7] += [0.5, 0.0, 0.0]
    found = solve(hand, camera)[0]
    assert np.linalg.norm(found.translation - hand_T_camera.translation) < 0.005


@pytest.mark.parametrize("offset", [-0.8, 0.031, 1.3])
def test_the_offset_of_the_clocks_is_found(offset: float) -> None:
    times = np.arange(0.0, 30.0, 0.02)
    hand = [
        Pose.from_rotation_vector([np.sin(t) + 0.3 * np.sin(2.7 * t), 0.5 * np.sin(1.7 * t), 0.0], [0.0, 0.0, 0.1 * t])
        for t in times
    ]
    base_T_hand, camera_T_target = _tracks(times, hand, Pose.identity(), Pose.identity())
    late = Track(times - offset, camera_T_target.rotations, camera_T_target.positions)
    paired, chosen, found = pair(base_T_hand, late)
    assert found == pytest.approx(offset, abs=0.005)
    assert len(paired.times) == len(chosen.times)


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="There is no"):
        read_track(tmp_path / "absent.csv")
    (tmp_path / "short.csv").write_text("0,0,0,0,0,0,0,1\n")
    with pytest.raises(InvalidInput, match="short"):
        read_track(tmp_path / "short.csv")
    (tmp_path / "words.csv").write_text("time,x\n")
    with pytest.raises(InvalidInput, match="no numbers"):
        read_track(tmp_path / "words.csv")
