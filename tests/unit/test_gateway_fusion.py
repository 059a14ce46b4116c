"""Each sample gets the tip's pose at its own time, or none."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_sensor_gateway.fusion import Fusion, fuse_span
from pretouch_sensor_gateway.history import MAX_MEASUREMENTS, SPAN, History
from pretouch_sensor_gateway.measurements import Measurements
from pretouch_sensor_gateway.pose_path import MAX_GAP, PosePath
from pretouch_sensor_gateway.range_batch import RangeBatch

from pretouch.errors import InvalidInput, TooLarge
from pretouch.geometry import Pose
from pretouch.tof import MAX_SAMPLES

T0 = 1.7e9


NOISE = 0.001
TIME_STD = 0.002


def batch(*t: float, ranges: tuple[float, ...] = (0.03,), status: tuple[int, ...] | None = None) -> RangeBatch:
    metres = np.tile(ranges, (len(t), 1))
    codes = np.tile(np.array(status or (0,) * len(ranges), dtype=np.uint8), (len(t), 1))
    sequence = np.arange(len(t), dtype=np.uint32)
    std = np.full(metres.shape, NOISE, dtype=np.float32)
    return RangeBatch(np.array(t), TIME_STD, sequence, 0, metres, metres, codes, np.zeros_like(codes), 0, std)


def frames(*t: float, ranges: tuple[float, ...] = (0.03,), status: tuple[int, ...] | None = None) -> Measurements:
    return Measurements.from_batch(batch(*t, ranges=ranges, status=status))


def fusion_on(path: PosePath, *modules: Pose) -> Fusion:
    return Fusion(path, modules or (Pose.identity(),))


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
    fusion = fusion_on(path_along_x([T0 + 0.1 * k for k in range(11)]))
    fusion.add(frames(*(T0 + offset for offset in sorted(offsets))))
    samples = fusion.take().samples
    assert len(samples) == len(offsets)
    for t, base_T_tip in zip(samples.t, samples.base_T_tip, strict=True):
        np.testing.assert_allclose(base_T_tip, looking_down(t - T0, 0.1, t - T0).matrix, atol=1e-6)


def test_newer_samples_wait_for_their_pose_older_ones_are_counted() -> None:
    path = path_along_x([T0, T0 + 0.1])
    fusion = fusion_on(path)
    fusion.add(frames(T0 - 0.001, T0 + 0.05, T0 + 0.15))
    first = fusion.take()
    assert (first.samples.t.tolist(), first.unposed) == ([T0 + 0.05], 1)
    assert fusion.complete
    again = fusion.take()
    assert (len(again.samples), again.unposed) == (0, 0)
    path.append(T0 + 0.2, looking_down(0.2, 0.1))
    assert not fusion.complete
    assert fusion.take().samples.t.tolist() == [T0 + 0.15]


def test_nothing_is_interpolated_across_a_gap() -> None:
    fusion = fusion_on(path_along_x([T0, T0 + MAX_GAP * 1.01, T0 + 0.4]))
    fusion.add(frames(T0, T0 + 0.1, T0 + 0.3))
    fused = fusion.take()
    assert (fused.samples.t.tolist(), fused.unposed) == ([T0, T0 + 0.3], 1)


def test_samples_that_wait_are_bounded() -> None:
    fusion = fusion_on(PosePath(), *[Pose.identity()] * 4)
    for k in range(0, MAX_SAMPLES // 4 + 3, 1):
        fusion.add(frames(T0 + k, ranges=(0.03,) * 4))
    assert fusion.take().unposed == 3


def test_waiting_frames_of_a_device_that_is_exchanged_are_counted() -> None:
    path = path_along_x([T0])
    fusion = fusion_on(path, *[Pose.identity()] * 2)
    fusion.add(frames(T0 + 0.05, T0 + 0.06, ranges=(0.03, 0.03)))
    fusion.add(frames(T0 + 0.07))
    path.append(T0 + 0.1, looking_down(0.1, 0.1))
    fused = fusion.take()
    assert (fused.samples.t.tolist(), fused.unposed) == ([T0 + 0.07], 2)


def test_points_lie_along_each_module_s_beam_and_a_miss_keeps_its_ray() -> None:
    sideways = Pose.from_rotation_vector([0, math.pi / 2, 0], [0, 0, 0.01])  # z of the module along x of the tip
    fusion = fusion_on(path_along_x([T0, T0 + 0.1]), Pose.identity(), sideways)
    fusion.add(frames(T0, ranges=(0.03, 0.02)))
    fusion.add(frames(T0 + 0.1, ranges=(0.03, math.nan)))
    fusion.add(frames(T0 + 0.1, ranges=(0.03, 0.02), status=(7, 0)))
    fused = fusion.take()
    assert fused.samples.module.tolist() == [0, 1, 0, 1, 0, 1]
    missed = [False, False, False, True, True, False]
    assert np.isnan(fused.points).any(axis=1).tolist() == missed
    assert np.isnan(fused.std).tolist() == missed
    np.testing.assert_allclose(fused.points[:2], [[0, 0, 0.07], [0.02, 0, 0.09]], atol=1e-9)
    np.testing.assert_allclose(fused.origins[:2], [[0, 0, 0.1], [0, 0, 0.09]], atol=1e-9)
    np.testing.assert_allclose(fused.directions[:2], [[0, 0, -1], [1, 0, 0]], atol=1e-9)
    assert np.isfinite(fused.origins).all()
    np.testing.assert_allclose(np.linalg.norm(fused.directions, axis=1), 1.0, atol=1e-9)


def test_the_std_of_a_point_holds_the_ranges_noise_and_the_way_it_moves_in_the_times_uncertainty() -> None:
    lever = Pose.of(np.eye(3), [0.05, 0, 0])
    path = PosePath()
    for t in np.arange(0.0, 0.21, 0.02):  # 0.3 m/s along y, turning 4 rad/s about the vertical
        path.append(T0 + t, Pose.from_rotation_vector([0, 0, 4 * t], [0, 0.3 * t, 0.1]))
    fusion = fusion_on(path, Pose.identity(), lever)
    fusion.add(frames(T0 + 0.1, ranges=(0.03, 0.03)))
    fused = fusion.take()
    along = np.array([-math.sin(0.4), math.cos(0.4)]) * 4 * 0.05  # of the lever's end, beside the tip's own way
    speeds = [0.3, math.hypot(along[0], along[1] + 0.3)]
    np.testing.assert_allclose(fused.std, np.hypot(NOISE, TIME_STD * np.array(speeds)), rtol=2e-3)


def test_a_tip_that_stands_still_leaves_only_the_ranges_noise() -> None:
    path = PosePath()
    for t in (T0, T0 + 0.1):
        path.append(t, looking_down(0.0, 0.1))
    fusion = fusion_on(path)
    fusion.add(frames(T0, T0 + 0.05))
    np.testing.assert_allclose(fusion.take().std, NOISE)


def test_a_module_that_was_not_described_is_said_to_be_so() -> None:
    fusion = fusion_on(path_along_x([T0]))
    with pytest.raises(InvalidInput, match="2 modules"):
        fusion.add(frames(T0, ranges=(0.03, 0.03)))


def test_poses_go_forward_in_time() -> None:
    path = path_along_x([T0, T0 + 0.1])
    assert path.append(T0 + 0.1, looking_down(5.0, 5.0))  # the same time again: the first one stays
    np.testing.assert_allclose(path.at([T0 + 0.1])[0, :3, 3], [0.1, 0, 0.1], atol=1e-6)
    assert not path.append(T0 + 0.05, looking_down(0, 0.1))
    assert path.end == T0 + 0.1


def test_a_past_span_takes_each_frame_once_from_the_newest_path_that_places_it() -> None:
    history = History()
    old, new = path_along_x([T0, T0 + 0.1, T0 + 0.2]), PosePath()
    for t in (T0 + 0.1, T0 + 0.3):
        new.append(t, looking_down(1.0, 0.5))
    history.add_path(old)
    history.add_path(new)
    for k in range(6):
        history.add(batch(T0 + 0.1 * k - 0.05))
    samples = fuse_span(*history.between(T0, T0 + 1.0))
    np.testing.assert_allclose(samples.t - T0, [0.05, 0.15, 0.25], atol=1e-6)
    np.testing.assert_allclose(samples.base_T_tip[:, 0, 3], [0.05, 1.0, 1.0], atol=1e-6)
    assert len(fuse_span(*history.between(T0 + 0.1, T0 + 0.2))) == 1
    assert len(fuse_span(Measurements.empty(), [])) == 0
    assert len(fuse_span(*History().between(T0, T0 + 1.0))) == 0


def test_a_span_is_bounded_in_samples() -> None:
    history = History()
    path = PosePath()
    history.add_path(path)
    history.add(batch(*(T0 + 0.01 * k for k in range(MAX_SAMPLES + 1))))
    for k in range(round(0.01 * MAX_SAMPLES / 0.2) + 2):
        path.append(T0 + 0.2 * k, looking_down(0, 0.1))
    with pytest.raises(TooLarge):
        fuse_span(*history.between(T0, T0 + 1000))


@given(rate=st.sampled_from([3.0, 30.0, 400.0]), hours=st.floats(0.01, 0.6))
@settings(max_examples=10, deadline=None)
def test_the_history_holds_the_last_ten_minutes_and_no_more(rate: float, hours: float) -> None:
    history = History()
    times = T0 + np.arange(int(hours * 3600 * rate)) / rate
    for part in np.array_split(times, 50):
        if len(part):
            history.add(batch(*part.tolist(), ranges=(0.03, 0.05)))
    kept, _ = history.between(0.0, 1e12)
    wanted = times[times >= times[-1] - SPAN][-MAX_MEASUREMENTS:]
    np.testing.assert_array_equal(kept.t, wanted)
    assert kept.range.shape == (len(wanted), 2)


def test_the_history_survives_a_jump_of_the_clock_and_another_device() -> None:
    history = History()
    history.add(batch(T0, T0 + 1))
    history.add(batch(T0 - 3600))
    kept, _ = history.between(T0 - 4000, T0 + 2)
    assert kept.t.tolist() == [T0 - 3600, T0, T0 + 1]
    history.add(batch(T0 + 5, ranges=(0.01, 0.02)))
    kept, _ = history.between(0, 1e12)
    assert kept.t.tolist() == [T0 + 5]
