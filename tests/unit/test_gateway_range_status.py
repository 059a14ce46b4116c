"""Status codes and flags are named on the wire, whatever the sensor, with its own code beside."""

from __future__ import annotations

import numpy as np
import pytest
from pretouch_sensor_gateway.device_statistics import DeviceStatistics
from pretouch_sensor_gateway.range_batch import Flag, RangeBatch
from pretouch_sensor_gateway.range_status import classify

from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import array_from_proto

GOOD, NO_TARGET, REJECTED, FAILED, NO_ANSWER = (
    pb.RANGE_STATUS_GOOD,
    pb.RANGE_STATUS_NO_TARGET,
    pb.RANGE_STATUS_REJECTED,
    pb.RANGE_STATUS_FAILED,
    pb.RANGE_STATUS_NO_ANSWER,
)


@pytest.mark.parametrize(
    ("wire_format", "codes", "meaning"),
    [
        ("binary", (0, 1, 5, 6, 7, 11, 255), (GOOD, FAILED, FAILED, REJECTED, NO_TARGET, REJECTED, NO_ANSWER)),
        ("stm32duino", (0, 1, 2, 4, 5, 7, 255), (GOOD, REJECTED, REJECTED, NO_TARGET, FAILED, NO_TARGET, NO_ANSWER)),
    ],
)
def test_codes_mean_what_the_sensors_data_sheets_say(
    wire_format: str, codes: tuple[int, ...], meaning: tuple[int, ...]
) -> None:
    status = np.array([codes], dtype=np.uint8)
    assert classify(status, np.full(status.shape, 0.03), wire_format).tolist() == [list(meaning)]


def test_a_good_status_without_a_range_is_no_target() -> None:
    assert classify(np.zeros(2, np.uint8), np.array([0.03, np.nan]), "binary").tolist() == [GOOD, NO_TARGET]


def test_every_code_means_something_and_only_0_is_good() -> None:
    for wire_format in ("binary", "stm32duino"):
        meaning = classify(np.arange(256), np.full(256, 0.03), wire_format)
        assert set(meaning.tolist()) <= set(pb.RangeStatus.values()) - {pb.RANGE_STATUS_UNSPECIFIED}
        assert np.flatnonzero(meaning == GOOD).tolist() == [0]


def test_batches_and_the_status_name_what_became_of_a_range_beside_the_sensors_own_code() -> None:
    ranges, status = np.array([[0.03, np.nan, 0.05]]), np.array([[0, 7, 2]], dtype=np.uint8)
    flags = np.array([[Flag.JUMP | Flag.WARMING_UP, 0, 0]], dtype=np.uint8)
    batch = RangeBatch(
        np.array([1.0]),
        0.0,
        np.zeros(1, np.uint32),
        0,
        ranges,
        ranges,
        status,
        flags,
        0,
        np.full((1, 3), 0.001, np.float32),
        "binary",
    )
    message = pb.RangeBatch.FromString(batch.message.SerializeToString())
    assert array_from_proto(message.status, "status").tolist() == status.tolist()
    assert array_from_proto(message.range_status, "range_status").tolist() == [[GOOD, NO_TARGET, FAILED]]
    assert message.flags.data[0] == pb.RANGE_FLAG_JUMP | pb.RANGE_FLAG_WARMING_UP
    assert RangeBatch.from_message(message).range_status.tolist() == [[GOOD, NO_TARGET, FAILED]]
    statistics = DeviceStatistics()
    statistics.add(batch, 0.0)
    assert [module.range_status for module in statistics.modules] == [GOOD, NO_TARGET, FAILED]
