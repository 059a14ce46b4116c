"""The guard follows the gateway's samples, module by module, and says when there are none."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from pretouch.client import Guard
from pretouch.errors import NotFound, Unavailable
from pretouch.tof import RangeSamples
from pretouch.v1.sensor_gateway_pb2 import StreamPointsResponse
from pretouch.wire.common import samples_to_proto

NONE = np.nan


def answer(*rows: tuple[float, float, int, int]) -> StreamPointsResponse:
    """Samples as (time, range, status, module)."""
    t, ranges, status, module = (np.array(column) for column in zip(*rows, strict=True))
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    return StreamPointsResponse(samples=samples_to_proto(RangeSamples(t, poses, ranges, status, module)))


def after(*answers: StreamPointsResponse) -> Guard:
    guard = Guard(answers)
    guard.finish()
    return guard


def test_the_lift_follows_the_samples_times() -> None:
    guard = after(answer((5.0, 0.012, 0, 0), (5.1, 0.012, 0, 0)), answer((5.2, 0.013, 0, 0)))
    assert guard.reflex.lift == pytest.approx(0.2 * guard.reflex.lift_speed)


def test_one_module_of_several_is_enough_to_lift_and_a_lost_row_is_no_sight() -> None:
    clear = ((1.0, 0.05, 0, 0), (1.0, 0.05, 0, 1), (1.0, 0.04, 0, 2))
    assert after(answer(*clear), answer((1.1, 0.05, 0, 0), (1.1, NONE, 14, 1), (1.1, 0.05, 0, 2))).reflex.rising
    lost = after(answer(*clear), answer((1.1, 0.06, 0, 1), (1.1, 0.05, 0, 2)))
    assert not lost.reflex.rising
    np.testing.assert_allclose(lost.reflex.ahead, [0.05, 0.06, 0.05])


def test_a_stream_without_samples_changes_nothing() -> None:
    assert after(StreamPointsResponse(samples=answer((1.0, 0.05, 0, 0)).samples)).reflex.lift == 0
    empty = RangeSamples(np.zeros(0), np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0, int), np.zeros(0, int))
    assert after(StreamPointsResponse(samples=samples_to_proto(empty), lost=3)).reflex.lift == 0


def test_a_stream_that_fails_stops_the_robot_and_is_told_at_the_end() -> None:
    def failing() -> Iterator[StreamPointsResponse]:
        yield answer((1.0, 0.05, 0, 0))
        raise NotFound("No device is called thumb.", "Use its name.")

    guard = Guard(failing())
    with pytest.raises(NotFound, match="thumb"):
        guard.finish()
    with pytest.raises(Unavailable, match=r"not heard.*thumb"):
        _ = guard.reflex


def test_a_silent_stream_stops_the_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pretouch.client.guard.SILENCE", -1.0)
    with pytest.raises(Unavailable, match="not heard"):
        _ = after(answer((1.0, 0.05, 0, 0))).reflex
