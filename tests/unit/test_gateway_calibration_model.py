"""The model of a module: readings to distances and back, and what it refuses."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pretouch_sensor_gateway.calibration.model import UNCALIBRATED, Calibration, ModuleCalibration
from pretouch_sensor_gateway.calibration.proto_conversion import calibration_from_proto, calibration_to_proto

from pretouch.errors import InvalidInput, Malformed
from pretouch.v1 import sensor_gateway_pb2 as pb

# Added to 0, 0.2, 0.4, 0.6 and 0.8 m, they never turn the order around.
CORRECTIONS = st.lists(st.floats(-0.09, 0.09), min_size=5, max_size=5).map(
    lambda added: tuple((0.2 * n, value) for n, value in enumerate(added))
)
MODULES = st.builds(
    ModuleCalibration,
    offset=st.floats(-0.1, 0.1),
    scale=st.floats(0.5, 2.0),
    crosstalk=st.one_of(st.just(0.0), st.floats(1e-6, 1e4)),
    std=st.floats(1e-6, 0.1),
    std_slope=st.floats(0.0, 1.0),
    residual=st.floats(0.0, 0.1),
    span=st.tuples(st.floats(0.0, 0.1), st.floats(0.2, 4.0)),
)
BENT = st.builds(
    ModuleCalibration,
    offset=st.floats(-0.1, 0.1),
    scale=st.floats(0.5, 2.0),
    std=st.floats(1e-6, 0.1),
    corrections=CORRECTIONS,
)
CALIBRATIONS = st.builds(
    Calibration,
    serial=st.text("0123456789abcdef", max_size=16),
    warm_up=st.floats(0, 3600),
    modules=st.lists(MODULES | BENT, min_size=1, max_size=8).map(tuple),
    bias_std=st.none() | st.floats(0, 0.1),
)


@given(MODULES, st.floats(0.0, 0.99))
def test_the_distance_of_a_reading_is_the_distance_it_was_read_at(module: ModuleCalibration, share: float) -> None:
    distance = np.array([share * min(module.reach, 4.0)])
    np.testing.assert_allclose(module.distance(module.predict_reading(distance)), distance, rtol=1e-9, atol=1e-12)


@given(BENT, st.floats(0.1, 4.0))
def test_a_bent_curve_is_inverted_too(module: ModuleCalibration, distance: float) -> None:
    r = np.array([distance])
    np.testing.assert_allclose(module.distance(module.predict_reading(r)), r, rtol=1e-9, atol=1e-12)
    readings = module.predict_reading(np.linspace(0.1, 4.0, 200))
    assert (np.diff(readings) > 0).all()


def test_corrections_are_linear_between_their_distances_and_constant_beyond() -> None:
    module = ModuleCalibration(0.01, corrections=((0.02, 0.001), (0.04, 0.003)))
    found = module.distance(np.array([0.02, 0.03, 0.04, 0.05, 0.06])) - np.array([0.01, 0.02, 0.03, 0.04, 0.05])
    np.testing.assert_allclose(found, [0.001, 0.001, 0.002, 0.003, 0.003])
    np.testing.assert_allclose(module.gain(np.array([0.015, 0.032, 0.06])), [1.0, 1.1, 1.0])


def test_a_range_beyond_what_was_calibrated_is_said_and_its_std_grows() -> None:
    module = ModuleCalibration(std=0.001, residual=0.0005, span=(0.02, 0.1))
    ranges = np.array([[0.012], [0.0175], [0.05], [0.1025], [0.2], [np.nan]])
    calibration = Calibration(modules=(module,))
    assert calibration.beyond(ranges)[:, 0].tolist() == [True, False, False, False, True, False]
    std = calibration.std_at(ranges)[:, 0]
    assert std[2] == pytest.approx(np.hypot(0.001, 0.0005))
    assert std[4] == pytest.approx(np.sqrt(0.001**2 + 0.0005**2 + 0.02**2))
    assert np.isnan(std[5])
    assert not Calibration().beyond(ranges).any()


@given(MODULES)
def test_within_the_reach_a_farther_target_reads_more_and_a_greater_reading_is_farther(
    module: ModuleCalibration,
) -> None:
    distances = np.linspace(0, 0.99 * min(module.reach, 4.0), 200)
    readings = module.predict_reading(distances)
    assert (np.diff(readings) > 0).all()
    assert (np.diff(module.distance(np.linspace(module.offset, readings[-1], 200))) > 0).all()


@given(MODULES, st.floats(0.0, 0.9))
def test_the_gain_is_the_slope_of_the_inverse(module: ModuleCalibration, share: float) -> None:
    r = np.array(share * min(module.reach, 4.0))
    reading, step = module.predict_reading(r), 1e-6 * min(module.reach, 1.0)
    ahead, behind = module.distance(reading + step), module.distance(np.maximum(reading - step, module.offset))
    width = step + np.minimum(step, reading - module.offset)
    np.testing.assert_allclose(module.gain(r), (ahead - behind) / width, rtol=1e-3)


def test_glass_shortens_what_is_read_by_its_share_of_the_light() -> None:
    module = ModuleCalibration(crosstalk=10.0)
    assert module.predict_reading(np.array(0.1)) == pytest.approx(0.1 / 1.1)
    assert module.reach == pytest.approx(math.sqrt(0.1))


def test_a_reading_that_no_distance_gives_is_a_miss() -> None:
    module = ModuleCalibration(0.002, 1.0, 25.0)  # at most 0.2 / 2 above the offset
    raw = np.array([0.1019, 0.1021, 10.0, np.nan])
    np.testing.assert_array_equal(np.isnan(module.distance(raw)), [False, True, True, True])


def test_a_reading_below_the_offset_is_contact_never_a_negative_range() -> None:
    assert ModuleCalibration(0.004).distance(np.array([0.001])) == 0


def test_uncalibrated_readings_are_distances_of_unknown_noise() -> None:
    raw = np.array([0.0, 0.0123, 4.0])
    np.testing.assert_array_equal(UNCALIBRATED.distance(raw), raw)
    np.testing.assert_array_equal(UNCALIBRATED.std_at(raw), [np.nan] * 3)


@given(CALIBRATIONS, st.integers(0, 5))
def test_a_device_is_its_modules_side_by_side(calibration: Calibration, frames: int) -> None:
    raw = np.random.default_rng(frames).uniform(-0.05, 0.3, (frames, len(calibration.modules)))
    raw[raw > 0.25] = np.nan
    kept = raw.copy()
    got, std = calibration.distance(raw), calibration.std_at(raw)
    assert got.shape == std.shape == raw.shape
    for k, module in enumerate(calibration.modules):
        np.testing.assert_allclose(got[:, k], module.distance(raw[:, k]))
        np.testing.assert_allclose(std[:, k], module.std_at(raw[:, k]))
    np.testing.assert_array_equal(raw, kept)


@pytest.mark.parametrize(
    ("changed", "kind"),
    [
        ({"offset": math.nan}, Malformed),
        ({"offset": 35.0}, InvalidInput),
        ({"scale": 0.0}, InvalidInput),
        ({"scale": 0.49}, InvalidInput),
        ({"scale": 2.01}, InvalidInput),
        ({"scale": math.inf}, Malformed),
        ({"crosstalk": -0.1}, InvalidInput),
        ({"std": 1e-9}, InvalidInput),
        ({"residual": -0.001}, InvalidInput),
        ({"span": (0.1, 0.02)}, InvalidInput),
        ({"span": (math.nan, 0.02)}, Malformed),
        ({"corrections": ((0.02, 0.0), (0.02, 0.001))}, InvalidInput),
        ({"corrections": ((0.02, 0.02), (0.03, 0.005))}, InvalidInput),
        ({"corrections": ((0.02, 0.2),)}, InvalidInput),
        ({"corrections": ((0.02, math.inf),)}, Malformed),
        ({"corrections": tuple((0.001 * n, 0.0) for n in range(257))}, InvalidInput),
        ({"std": 1.5}, InvalidInput),
        ({"std_slope": -0.01}, InvalidInput),
        ({"std_slope": "0.01"}, Malformed),
        ({"std": True}, Malformed),
    ],
)
def test_a_module_that_cannot_be_is_refused(changed: dict[str, Any], kind: type[InvalidInput]) -> None:
    with pytest.raises(InvalidInput) as caught:
        ModuleCalibration(**changed)
    assert type(caught.value) is kind
    assert caught.value.detail.startswith(next(iter(changed)))
    assert caught.value.remedy


@pytest.mark.parametrize(
    "changed",
    [
        {"serial": "COM3"},
        {"warm_up": -1.0},
        {"warm_up": math.nan},
        {"warm_up": 1e9},
        {"modules": ()},
        {"bias_std": -1.0},
    ],
)
def test_a_calibration_that_cannot_be_is_refused(changed: dict[str, Any]) -> None:
    with pytest.raises(InvalidInput):
        Calibration(**changed)


@given(CALIBRATIONS)
def test_a_calibration_crosses_the_wire_unchanged(calibration: Calibration) -> None:
    message = pb.Calibration.FromString(calibration_to_proto(calibration).SerializeToString())
    assert calibration_from_proto(message) == calibration


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (pb.Calibration(), "calibration: There are 0 modules"),
        (pb.Calibration(modules=[pb.ModuleCalibration()] * 257), "257"),
        (pb.Calibration(modules=[pb.ModuleCalibration(std=0.001)]), "calibration.modules[0]: scale is 0"),
        (pb.Calibration(modules=[pb.ModuleCalibration(scale=1, std=math.nan)]), "calibration.modules[0]: std is nan"),
    ],
)
def test_what_comes_over_the_wire_is_checked(message: pb.Calibration, said: str) -> None:
    with pytest.raises(InvalidInput) as caught:
        calibration_from_proto(message)
    assert said in caught.value.detail
