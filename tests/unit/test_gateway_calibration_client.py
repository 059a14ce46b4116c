"""How the device under calibration is called."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pretouch_sensor_gateway.calibration.device_client import DeviceClient
from pretouch_sensor_gateway.calibration.model import Calibration

from pretouch.errors import InvalidInput, Unavailable
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import array_to_proto


class Call:
    """Three batches of four frames, then the end."""

    def __init__(self) -> None:
        self.cancelled = False
        raw = np.array([[0.02, 0.03], [0.0, 0.031], [0.021, np.nan], [0.022, 0.03]])
        status = np.array([[0, 0], [7, 0], [0, 0], [0, 6]])
        batch = pb.RangeBatch(raw=array_to_proto(raw, "f8"), status=array_to_proto(status, "u1"), epoch=3)
        self._responses = iter([pb.StreamRangesResponse(batch=batch)] * 3)

    def __iter__(self) -> Call:
        return self

    def __next__(self) -> pb.StreamRangesResponse:
        return next(self._responses)

    def cancel(self) -> None:
        self.cancelled = True


class Stub:
    """A stub without a channel that notes in which threads it was called, and with which time limits."""

    def __init__(self) -> None:
        self.threads: set[threading.Thread] = set()
        self.timeouts: list[float] = []
        self.call = Call()
        self.status = pb.GetStatusResponse(
            device=pb.Device(name="left", state=pb.DEVICE_STATE_STREAMING), identity=pb.Identity(period=0.1, modules=2)
        )

    def _noted(self, answer: Any) -> Callable[..., Any]:
        def method(_: Any, timeout: float) -> Any:
            self.threads.add(threading.current_thread())
            self.timeouts.append(timeout)
            return answer

        return method

    def __getattr__(self, name: str) -> Callable[..., Any]:
        answers = {"GetStatus": self.status, "StreamRanges": self.call, "Configure": pb.ConfigureResponse()}
        return self._noted(answers[name])


def test_only_good_readings_count_and_no_more_than_asked_for() -> None:
    stub, told = Stub(), list[int]()
    frames = DeviceClient(stub, "").read(6, told.append)
    nan = np.nan
    expected = [[0.02, 0.03], [nan, 0.031], [0.021, nan], [0.022, nan], [0.02, 0.03], [nan, 0.031]]
    np.testing.assert_array_equal(frames.raw, expected)
    assert (frames.epoch, told, stub.call.cancelled) == (3, [4, 6], True)


def test_a_stream_that_ends_early_says_how_far_it_came() -> None:
    stub = Stub()
    with pytest.raises(Unavailable, match="Only 12 of 60 measurements"):
        DeviceClient(stub, "").read(60, lambda count: None)
    assert stub.call.cancelled


def test_nothing_is_called_from_the_thread_that_ctrl_c_interrupts_and_nothing_without_a_limit() -> None:
    stub = Stub()
    subject = DeviceClient(stub, "")
    subject.read(6, lambda count: None)
    subject.apply(Calibration())
    assert len(stub.threads) == 3
    assert threading.main_thread() not in stub.threads
    assert all(0 < timeout < 60 for timeout in stub.timeouts)


def test_an_interruption_cancels_the_stream() -> None:
    stub = Stub()

    def interrupt(count: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        DeviceClient(stub, "").read(60, interrupt)
    assert stub.call.cancelled


@pytest.mark.parametrize(
    ("batch", "said"),
    [
        (pb.RangeBatch(), "batch.raw"),
        (
            pb.RangeBatch(raw=array_to_proto(np.zeros((4, 2)), "f8"), status=array_to_proto(np.zeros((4, 3)), "u1")),
            "[4, 2] readings and [4, 3] status codes",
        ),
        (
            pb.RangeBatch(raw=array_to_proto(np.zeros(4), "f8"), status=array_to_proto(np.zeros(4), "u1")),
            "[4] readings",
        ),
    ],
)
def test_a_gateway_that_sends_nonsense_is_refused(batch: pb.RangeBatch, said: str) -> None:
    stub = Stub()
    stub.call._responses = iter([pb.StreamRangesResponse(batch=batch)])
    with pytest.raises(InvalidInput, match=re.escape(said)):
        DeviceClient(stub, "").read(60, lambda count: None)
    assert stub.call.cancelled


def test_modules_that_come_or_go_amid_a_distance_are_noticed() -> None:
    stub = Stub()
    batches = [
        pb.RangeBatch(raw=array_to_proto(np.zeros((4, k)), "f8"), status=array_to_proto(np.zeros((4, k)), "u1"))
        for k in (2, 1)
    ]
    stub.call._responses = iter([pb.StreamRangesResponse(batch=batch) for batch in batches])
    with pytest.raises(Unavailable, match="1 modules now, 2 before"):
        DeviceClient(stub, "").read(60, lambda count: None)
