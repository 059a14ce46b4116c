"""The fingertip's firmware with six simulated VL6180X: on this machine, as an Arduino sketch, and as AVRs' code."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from helpers.firmware_bench import MODULES, Bench, make, need, sanitizers
from pretouch_sensor_gateway.wire_formats.binary import encode
from pretouch_sensor_gateway.wire_formats.messages import COUNTER_MODULUS, Identify, Ping
from pretouch_sensor_gateway.wire_formats.parser import Identity, Measurement, PingReply

PERIOD = 30_000
NO_ANSWER = 255
BRING_UP_MS = 60  # all six modules, before the first measurement is started
BACK_MS = 1200  # a lost module is tried once a second
Command = tuple[str | Path, ...]


@pytest.fixture(scope="module", params=["native", "arduino", "atmega328p"])
def command(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Command:
    build = tmp_path_factory.mktemp("firmware")
    if request.param == "native":
        need("make", "cc")
        make("host", build, **sanitizers(build))
        return build / "finger-host", "--console"
    if request.param == "arduino":
        need("make", "cc", "c++")
        make("arduino", build, **sanitizers(build))
        return build / "finger-arduino", "--console"
    need("make", "cc", "avr-gcc", "simavr")
    if not Path("/usr/include/simavr/sim_avr.h").exists():
        pytest.skip("simavr's headers are not installed (Debian: libsimavr-dev)")
    make("simavr", build, MCU=request.param)
    return build / request.param / "finger-simavr", "--console", build / request.param / "finger.elf"


@pytest.fixture
def bench(command: Command) -> Iterator[Bench]:
    """A board just powered up. At the end nothing was refused, and the chips were never treated wrongly."""
    with Bench(*command) as bench:
        yield bench
        state = bench.tell("state")
        assert not bench.frames.refused
        assert [module["mistakes"] for module in state["modules"]] == [0] * MODULES


def steps(measurements: list[Measurement]) -> list[int]:
    """Microseconds from each measurement to the next."""
    micros = [measurement.micros or 0 for measurement in measurements]
    return [(later - earlier) % COUNTER_MODULUS for earlier, later in itertools.pairwise(micros)]


def in_sequence(measurements: list[Measurement]) -> bool:
    sequences = [measurement.sequence or 0 for measurement in measurements]
    return sequences == list(range(sequences[0], sequences[0] + len(sequences)))


def until(bench: Bench, wanted: Callable[[Measurement], bool], milliseconds: int) -> list[Measurement]:
    """Measurements up to and with the first one that is as wanted, which comes within `milliseconds`."""
    seen: list[Measurement] = []
    for _ in range(0, milliseconds, 30):
        seen += bench.measurements(30)
        if seen and wanted(seen[-1]):
            return seen
    raise AssertionError(f"not within {milliseconds} ms; last: {seen[-1:]}")


def all_good(measurement: Measurement) -> bool:
    return measurement.status == (0,) * MODULES


def test_a_start_ends_other_texts_says_who_it_is_and_counts_from_zero(bench: Bench) -> None:
    first, *measurements = bench.run(BRING_UP_MS + 100)
    assert bench.raw[0] == 0
    assert isinstance(first, Identity)
    assert (first.modules, first.period, first.firmware) == (MODULES, 0.03, "pretouch finger 1.0")
    assert isinstance(measurements[0], Measurement)
    assert measurements[0].sequence == 0
    assert measurements[0].boot == first.boot
    assert all_good(measurements[0])


@pytest.mark.parametrize("command", ["atmega2560", "atmega32u4"], indirect=True)
def test_other_boards_find_their_modules_measure_and_answer(bench: Bench) -> None:
    assert isinstance(bench.run(BRING_UP_MS + 100)[0], Identity)
    bench.tell("see 5 33 0")
    assert bench.measurements(120)[-1].ranges[5] == pytest.approx(0.033)
    bench.receive(encode(Ping(77)))
    assert [message.sequence for message in bench.run(40) if isinstance(message, PingReply)] == [77]
    assert [module["address"] for module in bench.tell("state")["modules"]] == [0x30, 0x31, 0x32, 0x33, 0x34, 0x35]


def test_each_module_gets_an_address_of_its_own_and_its_settings(bench: Bench) -> None:
    bench.run(BRING_UP_MS)
    state = bench.tell("state")
    assert [module["address"] for module in state["modules"]] == [0x30, 0x31, 0x32, 0x33, 0x34, 0x35]
    assert all(module["tuned"] and not module["held"] for module in state["modules"])
    assert state["collisions"] == 0


def test_ranges_and_statuses_are_those_that_the_modules_see(bench: Bench) -> None:
    bench.run(BRING_UP_MS)
    millimetres, status = (0, 10, 99, 200, 55, 55), (0, 0, 0, 0, 7, 11)
    for k in range(MODULES):
        bench.tell(f"see {k} {millimetres[k]} {status[k]}")
    last = bench.measurements(200)[-1]
    assert last.status == status
    assert last.ranges[:4] == pytest.approx([0.0, 0.010, 0.099, 0.200], abs=1e-9)
    assert all(math.isnan(metres) for metres in last.ranges[4:])


def test_measurements_follow_each_other_by_thirty_milliseconds_of_the_devices_clock(bench: Bench) -> None:
    bench.run(BRING_UP_MS + 100)
    measurements = bench.measurements(900)
    assert len(measurements) == 30
    assert in_sequence(measurements)
    assert all(abs(step - PERIOD) <= 100 for step in steps(measurements))
    assert abs(sum(steps(measurements)) - 29 * PERIOD) <= 100  # what one is late the next does not add to


@pytest.mark.parametrize("command", ["native"], indirect=True)  # whose clock starts just before it wraps
def test_nothing_happens_when_the_devices_clock_wraps(bench: Bench) -> None:
    bench.run(BRING_UP_MS + 100)
    measurements = bench.measurements(3000)
    assert (measurements[-1].micros or 0) < (measurements[0].micros or 0)
    assert in_sequence(measurements)
    assert all(abs(step - PERIOD) <= 100 for step in steps(measurements))


def test_every_ping_is_answered_with_the_time_at_which_the_answer_sets_out(bench: Bench) -> None:
    bench.run(BRING_UP_MS + 100)
    delays = []
    for sequence in range(20):
        bench.receive(encode(Ping(sequence)))
        for _ in range(20):
            replies = [message for message in bench.run(1) if isinstance(message, PingReply)]
            if replies:
                break
        (reply,) = replies
        assert reply.sequence == sequence
        delays.append((bench.tell("state")["micros"] - reply.micros) % COUNTER_MODULUS)
        bench.run(7)  # so that the pings meet every part of the period
    assert max(delays) - min(delays) < 1300  # the bench looks every 1000 us; a frame of ranges would hold it for 3000


def test_an_identify_is_answered(bench: Bench) -> None:
    bench.run(BRING_UP_MS)
    bench.receive(encode(Identify()))
    assert [message.modules for message in bench.run(40) if isinstance(message, Identity)] == [MODULES]


def test_requests_at_the_lines_full_rate_hold_up_no_measurement(bench: Bench) -> None:
    bench.run(BRING_UP_MS + 100)
    bench.receive(b"".join(encode(Ping(sequence)) + encode(Identify()) for sequence in range(300)))
    messages = bench.run(600)
    measurements = [message for message in messages if isinstance(message, Measurement)]
    assert len(measurements) >= 19
    assert in_sequence(measurements)
    assert sum(isinstance(message, PingReply) for message in messages) > 50


def test_a_module_that_is_unplugged_and_plugged_again_disturbs_no_other(bench: Bench) -> None:
    bench.run(BRING_UP_MS + 100)
    bench.tell("unplug 2")
    gone = bench.measurements(600)
    assert {measurement.status for measurement in gone[1:]} == {(0, 0, NO_ANSWER, 0, 0, 0)}
    assert all(math.isnan(measurement.ranges[2]) for measurement in gone[1:])
    bench.tell("plug 2")
    back = until(bench, all_good, BACK_MS)
    assert {measurement.status for measurement in back[:-1]} <= {(0, 0, NO_ANSWER, 0, 0, 0)}
    assert in_sequence(gone + back)
    assert all(abs(step - PERIOD) <= 500 for step in steps(gone + back))
    assert bench.tell("state")["modules"][2]["address"] == 0x32


def test_modules_that_are_missing_at_the_start_are_found_when_they_come(bench: Bench) -> None:
    for k in range(MODULES):
        bench.tell(f"unplug {k}")
    assert {measurement.status for measurement in bench.measurements(600)} == {(NO_ANSWER,) * MODULES}
    for k in range(MODULES):
        bench.tell(f"plug {k}")
    until(bench, all_good, BACK_MS)
    state = bench.tell("state")
    assert [module["address"] for module in state["modules"]] == [0x30, 0x31, 0x32, 0x33, 0x34, 0x35]


def test_two_modules_that_lose_their_power_at_once_get_their_addresses_again(bench: Bench) -> None:
    bench.run(BRING_UP_MS + 100)
    bench.tell("brownout 1")
    bench.tell("brownout 4")
    lost = until(bench, lambda measurement: not all_good(measurement), 90)
    back = until(bench, all_good, 300)
    assert {measurement.status[0] for measurement in lost + back} == {0}
    assert bench.tell("state")["modules"][4]["address"] == 0x34


def test_a_module_that_hangs_is_reset(bench: Bench) -> None:
    bench.run(BRING_UP_MS + 100)
    bench.tell("hang 5")
    hung = until(bench, lambda measurement: measurement.status[5] == NO_ANSWER, 90)
    back = until(bench, all_good, 300)
    assert in_sequence(hung + back)


def test_a_bus_that_a_cut_off_module_holds_is_clocked_free(bench: Bench) -> None:
    bench.run(BRING_UP_MS + 100)
    bench.tell("stick 9")
    bench.run(60)
    assert all_good(until(bench, all_good, BACK_MS)[-1])


def test_on_a_bus_that_stays_stuck_the_board_goes_on_to_say_so(bench: Bench) -> None:
    bench.run(BRING_UP_MS + 100)
    bench.tell("stick 1000000")
    stuck = until(bench, lambda measurement: measurement.status == (NO_ANSWER,) * MODULES, 300)
    bench.receive(encode(Ping(5)))
    messages = bench.run(300)
    assert [message.sequence for message in messages if isinstance(message, PingReply)] == [5]
    stuck += [message for message in messages if isinstance(message, Measurement)]
    assert in_sequence(stuck)
    bench.tell("stick 0")
    until(bench, all_good, BACK_MS)


@pytest.mark.parametrize("command", ["atmega328p"], indirect=True)  # whose watchdog is simulated
def test_a_processor_that_hangs_is_restarted_by_its_watchdog(bench: Bench) -> None:
    bench.run(BRING_UP_MS)
    before = bench.measurements(100)[-1]
    bench.tell("freeze")
    bench.run(10)  # what was on its way
    assert bench.run(200) == []
    bench.frames.restart()
    after = until(bench, all_good, 600)
    assert (after[-1].boot or 0) == (before.boot or 0) + 1


def test_a_failure_that_a_module_tells_of_itself_is_passed_on(bench: Bench) -> None:
    bench.run(BRING_UP_MS + 100)
    bench.tell("see 3 40 2")
    told = until(bench, lambda measurement: measurement.status[3] == 2, 90)
    assert math.isnan(told[-1].ranges[3])
    bench.tell("see 3 40 0")
    until(bench, lambda measurement: measurement.ranges[3] == pytest.approx(0.040), BACK_MS)


def test_a_module_ten_percent_slow_that_sees_no_target_is_still_in_time(bench: Bench) -> None:
    for k in range(MODULES):
        bench.tell(f"see {k} 255 7")
        bench.tell(f"slow {k} 10")
        bench.tell(f"convergence {k} 50000")
    bench.run(BRING_UP_MS + 60)
    assert {measurement.status for measurement in bench.measurements(600)} == {(7,) * MODULES}


def test_a_module_that_is_too_slow_is_never_started_while_it_measures(bench: Bench) -> None:
    bench.tell("slow 0 40")
    bench.tell("convergence 0 50000")
    bench.run(BRING_UP_MS + 60)
    statuses = {measurement.status for measurement in bench.measurements(600)}
    assert statuses == {(0,) * MODULES, (NO_ANSWER, 0, 0, 0, 0, 0)}  # the bench checks for mistakes at the end


def test_a_reboot_is_told_by_the_next_boot_number(bench: Bench) -> None:
    bench.run(BRING_UP_MS)
    before = bench.measurements(100)[-1]
    bench.tell("reboot")
    bench.frames.restart()
    identity, *measurements = bench.run(BRING_UP_MS + 100)
    assert isinstance(identity, Identity)
    assert bench.raw[0] == 0
    assert identity.boot == (before.boot or 0) + 1
    assert next(m.sequence for m in measurements if isinstance(m, Measurement)) == 0
    assert all_good(bench.measurements(60)[-1])


@pytest.mark.parametrize("seed", range(3))
def test_garbage_and_endless_input_do_no_harm(bench: Bench, seed: int) -> None:
    bench.run(BRING_UP_MS + 100)
    chance = random.Random(seed)
    parts = [
        chance.randbytes(2000),
        bytes(chance.choices(range(1, 256), k=2000)),  # no zero: one endless frame
        bytes(300),
        bench.raw * 3,  # an echo of its own words
        encode(Ping(1))[:-1] * 20 + b"\0",
    ]
    data = b"".join(parts)
    bench.receive(data)
    measurements = bench.measurements(round(len(data) / 11.52) + 100)
    assert in_sequence(measurements)
    assert all(all_good(measurement) for measurement in measurements)
    bench.receive(b"\0" + encode(Ping(77)))
    assert [message.sequence for message in bench.run(40) if isinstance(message, PingReply)] == [77]
