"""A device's bytes become batches with times; what is missing is counted, and what does not fit is not believed."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from pretouch_sensor_gateway.calibration.model import Calibration, ModuleCalibration
from pretouch_sensor_gateway.measurement_pipeline import MAX_HELD, MeasurementPipeline
from pretouch_sensor_gateway.range_batch import Flag, RangeBatch
from pretouch_sensor_gateway.wire_formats.binary import BinaryParser, encode
from pretouch_sensor_gateway.wire_formats.parser import Measurement, Refusal
from pretouch_sensor_gateway.wire_formats.registry import create_parser

from benchmarks.virtual_finger import VirtualFinger

UNIX = 1.7e9
"""Unix time at host time 0."""


class Bench:
    """A pipeline and a finger on its line, in time that the test moves."""

    def __init__(self, finger: VirtualFinger | None = None, calibration: Calibration | None = None) -> None:
        self.finger = finger or VirtualFinger()
        self.pipeline = MeasurementPipeline(BinaryParser(), 0.0, calibration)
        self.now = 0.0
        self.unix = UNIX
        self.batches: list[RangeBatch] = []
        self.pipeline.on_port_opened(self.now)

    def hear(self, data: bytes) -> list[RangeBatch]:
        batches = self.pipeline.feed(data, self.now, self.unix + self.now)
        self.batches += batches
        return batches

    def run(self, seconds: float, heard: bool = True) -> None:
        """The finger measures and is talked to; not `heard`: what it sends is lost."""
        end = self.now + seconds
        while self.now < end:
            self.now = min(self.finger.next_due, max(self.now, self.pipeline.next_send), end)
            if self.pipeline.next_send <= self.now:
                replies = self.finger.answers(self.pipeline.take_outgoing(self.now), self.now + 0.0005)
                self.now += 0.001
                if heard:
                    self.hear(replies)
            if self.finger.next_due <= self.now:
                frame = self.finger.measure()
                if heard:
                    self.hear(frame)

    @property
    def delivered(self) -> int:
        return sum(len(batch) for batch in self.batches)

    @property
    def lost(self) -> int:
        return sum(batch.lost for batch in self.batches)


def test_batches_come_with_the_time_of_the_measurement() -> None:
    bench = Bench(VirtualFinger(start=-5.0, first_tick=2**32 - 1_000_000, drift=40e-6))
    bench.finger.sent = 150
    bench.run(10.0)
    t = np.concatenate([batch.t for batch in bench.batches])
    true = UNIX - 5.0 + (np.concatenate([batch.sequence for batch in bench.batches]) + 1) / 30
    assert np.abs(t - true).max() < 1e-3  # the round trip is 1 ms
    assert max(batch.time_std for batch in bench.batches[30:]) < 1e-3
    assert {batch.range.shape[1] for batch in bench.batches} == {6}
    assert bench.pipeline.clock.synchronised


def test_frames_wait_for_the_clock_and_come_then() -> None:
    bench = Bench()
    frame = bench.finger.measure()
    bench.now = bench.finger.next_due
    assert bench.hear(frame) == []
    bench.run(0.2)
    assert bench.batches[0].sequence[0] == 0
    assert bench.delivered == bench.finger.sent


def test_frames_of_a_device_that_answers_no_pings_are_counted_and_the_first_batch_tells() -> None:
    bench = Bench()
    for _ in range(MAX_HELD + 10):
        bench.now = bench.finger.next_due
        bench.hear(bench.finger.measure())
    assert bench.pipeline.untimed == 10
    assert "answers no pings" in bench.pipeline.problem()
    bench.run(2.0)
    assert bench.pipeline.problem() == ""
    assert bench.delivered + bench.lost == bench.finger.sent
    assert bench.batches[0].lost == 10


@pytest.mark.parametrize("start", [0, 2**32 - 5])
def test_gaps_in_the_sequence_are_told_also_across_its_wrap(start: int) -> None:
    bench = Bench()
    bench.finger.sent = start
    bench.finger.start -= start / 30
    bench.run(1.0)
    before = bench.delivered
    bench.run(0.5, heard=False)
    bench.run(1.0)
    assert bench.lost == bench.pipeline.lost > 10
    assert bench.delivered > before
    assert start + bench.delivered + bench.lost == bench.finger.sent
    steps = [np.diff(np.concatenate([batch.sequence for batch in bench.batches]).astype(np.int64)) % 2**32]
    assert np.sum(np.concatenate(steps) - 1) == bench.lost, "the gap is in the sequence numbers"


def test_a_device_that_starts_anew_begins_an_epoch_and_what_it_measured_unheard_is_lost() -> None:
    bench = Bench()
    bench.run(2.0)
    first = bench.finger
    bench.finger = VirtualFinger(boot=2, start=bench.now + 0.5, first_tick=123_456)
    bench.run(1.0, heard=False)
    bench.run(2.0)
    assert bench.pipeline.epoch == 1
    epochs = [batch.epoch for batch in bench.batches]
    assert epochs == sorted(epochs)
    assert set(epochs) == {0, 1}
    assert bench.delivered + bench.lost == first.sent + bench.finger.sent
    new = [batch for batch in bench.batches if batch.epoch == 1]
    true = UNIX + bench.finger.start + (new[0].sequence + 1) / 30
    assert np.abs(new[0].t - true).max() < 2e-3


def test_a_board_that_has_been_running_elsewhere_is_another_epoch_and_has_lost_nothing_here() -> None:
    bench = Bench()
    bench.run(2.0)
    bench.finger = VirtualFinger(boot=9, start=bench.now - 3600.0)
    bench.finger.sent = 30 * 3600
    bench.run(1.0)
    assert bench.pipeline.epoch == 1
    assert bench.lost == 0


def test_a_reboot_without_a_new_boot_number_is_seen_by_its_sequence() -> None:
    bench = Bench()
    bench.run(10.0)
    bench.finger = VirtualFinger(boot=1, start=bench.now, first_tick=77)
    bench.run(1.0)
    assert bench.pipeline.epoch == 1
    assert bench.batches[-1].epoch == 1


def test_one_frame_that_does_not_follow_is_refused_and_changes_nothing() -> None:
    bench = Bench()
    bench.run(1.0)
    for boot, sequence, micros in [(7, 31, bench.finger.micros(1.0)), (1, 5, 0), (1, 2**31, 1), (1, 40, 2**31)]:
        bench.hear(encode(Measurement(boot, sequence, micros, (0.03,) * 6, (0,) * 6)))
        bench.run(0.2)
    assert bench.pipeline.refused[Refusal.IMPLAUSIBLE] == 4
    assert bench.pipeline.epoch == 0
    assert bench.lost == 0
    assert bench.delivered == bench.finger.sent


def test_the_same_frame_twice_counts_once() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.now = bench.finger.next_due
    frame = bench.finger.measure()
    bench.hear(frame)
    bench.hear(frame)
    bench.run(0.5)
    assert bench.delivered == bench.finger.sent
    assert bench.pipeline.refused[Refusal.IMPLAUSIBLE] == 1


def test_replies_to_no_ping_of_ours_change_no_clock() -> None:
    bench = Bench()
    bench.run(3.0)
    before = bench.pipeline.clock
    strange = VirtualFinger(boot=1, start=-100.0)
    other = MeasurementPipeline(BinaryParser(), 0.0, None)
    other.on_port_opened(0.0)
    bench.hear(strange.answers(other.take_outgoing(0.0), bench.now))
    assert bench.pipeline.clock == before


def test_a_jump_of_the_hosts_clock_moves_times_and_nothing_else() -> None:
    bench = Bench()
    bench.run(2.0)
    bench.unix += 3600.0
    bench.run(2.0)
    assert bench.pipeline.clock.host_jumps == 1
    assert bench.pipeline.epoch == 0
    assert bench.delivered == bench.finger.sent
    true = UNIX + 3600.0 + (bench.batches[-1].sequence + 1) / 30
    assert np.abs(bench.batches[-1].t - true).max() < 2e-3


def test_a_calibration_is_applied_and_the_raw_range_is_kept() -> None:
    modules = tuple(ModuleCalibration(offset=0.001 * k, scale=1.05) for k in range(6))
    bench = Bench(calibration=Calibration(modules=modules, warm_up=1.5))
    bench.run(3.0)
    batch = bench.batches[-1]
    np.testing.assert_allclose(batch.range, (batch.raw - 0.001 * np.arange(6)) / 1.05, atol=1e-12)
    warm = [bool((batch.flags & Flag.WARMING_UP).any()) for batch in bench.batches]
    assert warm[0]
    assert not warm[-1]
    assert warm == sorted(warm, reverse=True)


def test_a_board_that_was_not_calibrated_is_not_passed_on_until_the_right_one_comes() -> None:
    modules = (ModuleCalibration(),) * 6
    bench = Bench(VirtualFinger(serial="00000000000000bb"), Calibration("00000000000000aa", 0.0, modules))
    bench.run(1.0)
    assert bench.delivered == 0
    assert bench.pipeline.refused[Refusal.FOREIGN] > 10
    assert "00000000000000bb" in bench.pipeline.problem()
    bench.finger = VirtualFinger(boot=2, start=bench.now)
    bench.run(1.0)
    assert bench.pipeline.problem() == ""
    assert bench.delivered == bench.finger.sent


def test_another_number_of_modules_than_calibrated_is_refused_with_the_reason() -> None:
    bench = Bench(VirtualFinger(modules=2), Calibration(modules=(ModuleCalibration(),) * 6))
    bench.run(1.0)
    assert bench.delivered == 0
    assert bench.pipeline.refused[Refusal.FOREIGN] == bench.finger.sent
    assert "2 modules" in bench.pipeline.problem()


def test_an_outlier_is_flagged_and_an_edge_only_once() -> None:
    bench = Bench()
    bench.run(0.5)
    start = len(bench.batches)
    for metres in (0.030, 0.031, 0.085, 0.031, 0.030, 0.060, 0.061, 0.060):
        bench.now = bench.finger.next_due
        bench.hear(bench.finger.measure(metres))
        bench.run(0.0)
    jumped = [bool((batch.flags & Flag.JUMP).all()) for batch in bench.batches[start:]]
    assert jumped[1:] == [False, True, False, False, True, False, False]


def test_text_lines_have_times_without_pings_and_nothing_is_sent() -> None:
    pipeline = MeasurementPipeline(create_parser("millimetres"), 10 / 115_200, None)
    pipeline.on_port_opened(0.0)
    batches = []
    for k in range(30):
        at = 1.0 + k / 30
        assert pipeline.next_send == float("inf")
        assert pipeline.take_outgoing(at) == b""
        batches += pipeline.feed(b"34 35 36\r\n", at, UNIX + at)
    assert sum(len(batch) for batch in batches) == 29  # before the first line end, half a line may have come
    last = batches[-1]
    true = UNIX + at - 1 / 60 - 10 * 10 / 115_200
    assert abs(last.t[0] - true) < 2e-3
    assert 1 / 30 / 12**0.5 <= last.time_std < 0.02
    assert list(itertools.chain(*(batch.sequence for batch in batches))) == list(range(29))


@pytest.mark.parametrize("bytes_per_read", [1, 5, 100])
def test_a_line_took_as_long_on_the_wire_as_its_own_bytes_however_they_are_read(bytes_per_read: int) -> None:
    byte_time = 10 / 9600
    pipeline = MeasurementPipeline(create_parser("millimetres"), byte_time, None, latency=0.0)
    pipeline.on_port_opened(0.0)
    line, batches = b"34.5 35.5 36.5 37.5\r\n", []
    for k in range(20):
        begin = 1.0 + k / 30
        for start in range(0, len(line), bytes_per_read):
            at = begin + min(start + bytes_per_read, len(line)) * byte_time
            batches += pipeline.feed(line[start : start + bytes_per_read], at, UNIX + at)
    begins = UNIX + 1.0 + np.arange(1, 20) / 30  # before the first line end, half a line may have come
    late = np.concatenate([batch.t for batch in batches]) - begins
    assert np.all((late > -1e-6) & (late <= bytes_per_read * byte_time))
    assert np.ptp(late) < 1e-6


def test_lines_in_one_read_were_sent_one_after_the_other() -> None:
    byte_time = 10 / 9600
    pipeline = MeasurementPipeline(create_parser("millimetres"), byte_time, None, latency=0.0)
    pipeline.on_port_opened(0.0)
    pipeline.feed(b"\n", 0.0, UNIX)
    (batch,) = pipeline.feed(b"34 35\n36 37\n38 39\n", 1.0, UNIX + 1.0)
    assert batch.t - UNIX == pytest.approx([1.0 - 6 * n * byte_time for n in (3, 2, 1)], abs=1e-6)


def test_a_latency_that_is_stated_moves_the_times_of_a_finger_that_answers_pings() -> None:
    finger = VirtualFinger()
    bench = Bench(finger)
    bench.pipeline = MeasurementPipeline(BinaryParser(), 0.0, None, latency=0.015)
    bench.pipeline.on_port_opened(bench.now)
    bench.run(3.0)
    sequence = np.concatenate([batch.sequence for batch in bench.batches])
    late = np.concatenate([batch.t for batch in bench.batches]) - UNIX - finger.time_of(sequence)
    assert np.median(late) == pytest.approx(-0.015, abs=1e-3)
    assert bench.pipeline.clock.latency == 0.015


def test_lines_that_came_before_their_format_was_recognised_have_no_honest_time() -> None:
    pipeline = MeasurementPipeline(create_parser("auto"), 10 / 115_200, None)
    pipeline.on_port_opened(0.0)
    batches = []
    for k in range(40):
        at = 1.0 + k / 30
        batches += pipeline.feed(b"\ntof: 34 mm", at, UNIX + at)
    assert pipeline.format_name == "tof: {range:mm} mm"
    assert pipeline.untimed > 5
    assert pipeline.measurements + pipeline.untimed == 39  # the last line is half
    assert sum(len(batch) + batch.lost for batch in batches) == 39
    assert max(abs(batch.t[0] - UNIX - 1.0) for batch in batches[:1]) > 0.2


def test_another_format_on_the_same_line_is_another_device() -> None:
    pipeline = MeasurementPipeline(create_parser("auto"), 0.0, None)
    pipeline.on_port_opened(0.0)
    finger = VirtualFinger()
    for _ in range(5):
        at = finger.next_due
        assert pipeline.feed(finger.measure(), at, UNIX + at) == []  # held: no ping is answered
    pipeline.on_port_closed()
    pipeline.on_port_opened(1.0)
    batches = []
    for k in range(40):
        at = 1.0 + k / 30
        batches += pipeline.feed(b"\nd1: 34 mm d2: 35 mm", at, UNIX + at)
    assert (pipeline.epoch, pipeline.format_name) == (1, "d1: {range:mm} mm d2: {range:mm} mm")
    assert pipeline.untimed >= 5
    assert {batch.epoch for batch in batches} == {1}
    assert {batch.modules for batch in batches} == {2}
