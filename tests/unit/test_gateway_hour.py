"""One hour with a fault every 20 s: what was sent was delivered, or reported lost."""

from __future__ import annotations

import pytest

from benchmarks.faulty_hour import Hour


@pytest.fixture(scope="module")
def hour() -> Hour:
    hour = Hour(seed=0)
    hour.run(3600.0)
    return hour


def test_what_was_sent_was_delivered_or_reported_lost(hour: Hour) -> None:
    assert hour.faults.total() == 179
    assert len(hour.faults) == 12
    assert hour.sent > 100_000
    assert hour.delivered + hour.reported == hour.sent


def test_each_subscriber_is_told_the_same_sum(hour: Hour) -> None:
    assert hour.quick.overrun == 0
    assert hour.quick.got + hour.quick.lost == hour.sent
    assert hour.slow.overrun > 1000
    assert hour.slow.got + hour.slow.lost + hour.slow.overrun == hour.sent


def test_epochs_and_jumps_are_those_that_happened(hour: Hour) -> None:
    assert hour.pipeline.epoch == hour.faults["reboot"] + 2 * hour.faults["another_board"]
    assert hour.pipeline.clock.host_jumps == hour.faults["host_jump"]


def test_no_measurement_was_given_a_wrong_time(hour: Hour) -> None:
    assert hour.worst_time_error < 0.01
