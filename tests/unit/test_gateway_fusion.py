"""Each sample gets the tip's pose at its own time, or none."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_sensor_gateway.fusion import Fusion, fuse_span
from pretouch_sensor_gateway.history import SPAN, History
from pretouch_sensor_gateway.poses import MAX_GAP, PosePath
from pretouch_sensor_gateway.subscription import TimedFrame

from pretouch.errors import InvalidInput, TooLarge
from pretouch.geometry import Pose
from pretouch.tof import MAX_SAMPLES

T0 = 1.7e9


def frame(t: float, *ranges: float, status: tuple[int, ...] | None = None) -> TimedFrame:
    metres = ranges or (0.03,)
    return TimedFrame(0, t, metres, status or (0,) * len(metres))


def looking_down(x: float, z: float, turn: float = 0.0) -> Pose:
    return Pose.from_rotation_vector([0, 0, turn], [x, 0, z]) @ Pose.from_rotation_vector([math.pi, 0, 0], [0, 0, 0])


def path_along_x(times: list[float]) -> PosePath:
    """x = t - T0 at 1 m/s, turning 1 rad/s about z, beam down."""
    path = PosePath()
    for t in times:
        path.append(t, looking_down(t - T0, 0.1, t - T0))
    return path


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=20))
@settings(max_examples=50)
def test_poses_are_interpolated_at_each_sample_s_own_time(offsets: list[float]) -> None:
    fusion = Fusion(path_along_x([T0 + 0.1 * k for k in range(11)]), [Pose.identity()])
    fusion.add([frame(T0 + offset) for offset in sorted(offsets)])
    samples = fusion.take().samples
    assert len(samples) == len(offsets)
    for t, base_T_tip in zip(samples.t, samples.base_T_tip, strict=True):
        np.testing.assert_allclose(base_T_tip, looking_down(t - T0, 0.1, t - T0).matrix, atol=1e-6)


def test_newer_samples_wait_for_their_pose_older_ones_are_counted() -> None:
    path = path_along_x([T0, T0 + 0.1])
    fusion = Fusion(path, [Pose.identity()])
    fusion.add([frame(T0 - 0.001), frame(T0 + 0.05), frame(T0 + 0.15)])
    first = fusion.take()
    assert (first.samples.t.tolist(), first.unposed) == ([T0 + 0.05], 1)
    assert fusion.complete
    again = fusion.take()
    assert (len(again.samples), again.unposed) == (0, 0)
    path.append(T0 + 0.2, looking_down(0.2, 0.1))
    assert not fusion.complete
    assert fusion.take().samples.t.tolist() == [T0 + 0.15]


def test_nothing_is_interpolated_across_a_gap() -> None:
    path = path_along_x([T0, T0 + MAX_GAP * 1.01, T0 + 0.4])
    fusion = Fusion(path, [Pose.identity()])
    fusion.add([frame(T0), frame(T0 + 0.1), frame(T0 + 0.3)])
    fused = fusion.take()
    assert (fused.samples.t.tolist(), fused.unposed) == ([T0, T0 + 0.3], 1)


def test_samples_that_wait_are_bounded() -> None:
    fusion = Fusion(PosePath(), [Pose.identity()] * 4)
    fusion.add([frame(T0 + k) for k in range(MAX_SAMPLES // 4 + 3)])
    assert fusion.take().unposed == 3


def test_points_lie_along_each_module_s_beam_and_only_where_it_came_back() -> None:
    sideways = Pose.from_rotation_vector([0, math.pi / 2, 0], [0, 0, 0.01])  # z of the module along x of the tip
    fusion = Fusion(path_along_x([T0, T0 + 0.1]), [Pose.identity(), sideways])
    fusion.add([frame(T0, 0.03, 0.02), frame(T0 + 0.1, 0.03, math.nan), frame(T0 + 0.1, 0.03, 0.02, status=(7, 0))])
    fused = fusion.take()
    assert fused.samples.module.tolist() == [0, 1, 0, 1, 0, 1]
    assert len(fused.points) == 4
    np.testing.assert_allclose(fused.points[:2], [[0, 0, 0.07], [0.02, 0, 0.09]], atol=1e-9)


def test_a_module_that_was_not_described_is_said_to_be_so() -> None:
    fusion = Fusion(path_along_x([T0]), [Pose.identity()])
    with pytest.raises(InvalidInput, match="2 modules"):
        fusion.add([frame(T0, 0.03, 0.03)])


def test_poses_go_forward_in_time() -> None:
    path = path_along_x([T0, T0 + 0.1])
    path.append(T0 + 0.1, looking_down(5.0, 5.0))  # the same time again: the first one stays
    np.testing.assert_allclose(path.at([T0 + 0.1])[0, :3, 3], [0.1, 0, 0.1], atol=1e-6)
    with pytest.raises(InvalidInput, match="before the one sent"):
        path.append(T0 + 0.05, looking_down(0, 0.1))


def test_a_past_span_takes_each_frame_once_from_the_newest_path_that_places_it() -> None:
    history = History()
    old, new = path_along_x([T0, T0 + 0.1, T0 + 0.2]), PosePath()
    for t in (T0 + 0.1, T0 + 0.3):
        new.append(t, looking_down(1.0, 0.5))
    history.remember(old)
    history.remember(new)
    for k in range(6):
        history.add(frame(T0 + 0.1 * k - 0.05))
    samples = fuse_span(*history.between(T0, T0 + 1.0))
    np.testing.assert_allclose(samples.t - T0, [0.05, 0.15, 0.25], atol=1e-6)
    np.testing.assert_allclose(samples.base_T_tip[:, 0, 3], [0.05, 1.0, 1.0], atol=1e-6)
    assert len(fuse_span(*history.between(T0 + 0.1, T0 + 0.2))) == 1
    assert len(fuse_span([], [])) == 0


def test_the_history_is_bounded_in_time_and_a_span_in_samples() -> None:
    history = History()
    path = PosePath()
    history.remember(path)
    for k in range(MAX_SAMPLES + 1):
        history.add(frame(T0 + 0.01 * k))
    for k in range(round(0.01 * MAX_SAMPLES / 0.2) + 2):
        path.append(T0 + 0.2 * k, looking_down(0, 0.1))
    with pytest.raises(TooLarge):
        fuse_span(*history.between(T0, T0 + 1000))
    history.add(frame(T0 + SPAN + 10.0))
    frames, _ = history.between(0.0, T0 + 10.0 - 0.005)
    assert frames == []
