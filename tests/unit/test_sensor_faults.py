"""A session whose fingertip measures nothing reports it and keeps the pose; a sound fingertip raises no false alarm."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pretouch_orchestrator.perception.sensor_check import Fault, diagnose
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store.protocol import NewEvent
from pretouch_orchestrator.store.sqlite import open_store
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar
from pretouch_simulation.finger import Finger, FingerModel, realise
from pretouch_simulation.fingers.faults import (
    make_dead_finger,
    make_millimetre_finger,
    make_noise_finger,
    make_stuck_finger,
    make_stuck_module,
)
from pretouch_simulation.in_process import InProcessDetector, InProcessRegistrar
from pretouch_simulation.mesh import Mesh
from pretouch_simulation.objects import bowl, box, can, drill, mug
from pretouch_simulation.protocol import Case, generator, make_case
from pretouch_simulation.scanning import scan_along

from pretouch.client import Reflex
from pretouch.errors import InvalidInput
from pretouch.geometry import Pose
from pretouch.session import Budget, Proposer, ScanSettings, SessionRequest, State
from pretouch.tof import RangeSamples
from pretouch.wire import json

CASE = make_case("drill", drill(), 0)
INITIAL = CASE.error(Pose.identity())
SOUND = realise(FingerModel.IDEAL, generator("sound"))
LOOP = Loop(InProcessDetector(), InProcessRegistrar(Engine.POSTERIOR, Registrar()))


def opened(finger: Finger, case: Case = CASE, scans: int = 4, *, guarded: bool = False) -> Record:
    request = SessionRequest(
        case.camera,
        case.base_T_camera,
        depth_scale=1.0,
        sensor=finger.sensor,
        proposer=Proposer.RANDOM,
        budget=Budget(scans, 1e5, 1.0),
        scan=ScanSettings(guarded=guarded),
    )
    return asyncio.run(LOOP.open("s", 0.0, request, case.depth, case.mask))


def scan(record: Record, finger: Finger, case: Case = CASE) -> RangeSamples:
    assert record.next_scan is not None
    rng = generator("scan", len(record.scans))
    reflex = Reflex() if record.request.scan.guarded else None
    return scan_along(case.world, record.next_scan.path, record.request.sensor, finger, rng, reflex)


def scanned(record: Record, finger: Finger) -> Record:
    assert record.next_scan is not None
    return asyncio.run(LOOP.advance(record, record.next_scan.scan_id, scan(record, finger)))


def kind(record: Record) -> str:
    assert record.reason is not None
    return str(record.reason["type"]).removeprefix("urn:pretouch:problem:")


@pytest.mark.parametrize(
    ("fault", "kinds", "guarded"),
    [
        (make_stuck_finger, {"sensor"}, False),
        (lambda finger: make_stuck_finger(finger, at=0.06), {"sensor"}, False),
        (make_noise_finger, {"sensor"}, False),
        (make_dead_finger, {"sensor", "out-of-range"}, False),
        (lambda finger: make_stuck_finger(finger, at=0.012), {"sensor"}, True),
        (make_noise_finger, {"sensor"}, True),
        (make_dead_finger, {"sensor", "out-of-range"}, True),
    ],
    ids=["stuck", "stuck-at-60-mm", "noise", "dead", "stuck-and-lifted", "noise-lifted", "dead-guarded"],
)
def test_a_finger_that_measures_nothing_ends_the_session_and_moves_nothing(
    fault: Callable[[Finger], Finger], kinds: set[str], guarded: bool
) -> None:
    broken = fault(SOUND)
    record = opened(broken, guarded=guarded)
    while not record.state.ended:
        record = scanned(record, broken)
        assert CASE.error(record.estimate.base_T_correction) <= INITIAL + 0.001
    assert record.state is State.EXHAUSTED
    assert kind(record) in kinds
    assert record.budget_used.scans == len(record.scans) == len(record.measured) >= 2
    assert record.budget_used.seconds == pytest.approx(sum(summary.duration for summary in record.scans))
    assert all(summary.samples > 0 and summary.returns == 0 for summary in record.scans)


def test_a_finger_in_millimetres_is_refused_and_the_session_waits_for_the_same_scan() -> None:
    record = opened(SOUND)
    with pytest.raises(InvalidInput, match="look like millimetres"):
        scanned(record, make_millimetre_finger(SOUND))
    assert len(scanned(record, SOUND).scans) == 1


def test_what_is_left_out_of_a_scan_is_a_warning() -> None:
    (warning,) = scanned(opened(SOUND), make_stuck_finger(SOUND)).warnings
    assert warning.code == "samples-left-out"
    assert "In scan-1: The sensor reads" in warning.detail


def test_a_dead_finger_does_not_lower_the_next_path() -> None:
    record = opened(SOUND)
    after = scanned(record, make_dead_finger(SOUND))
    assert after.estimate.base_T_correction.is_close(record.estimate.base_T_correction)
    np.testing.assert_array_equal(after.estimate.covariance, record.estimate.covariance)


def test_a_finger_that_breaks_is_noticed_within_two_scans_and_one_that_is_mended_goes_on() -> None:
    good = scanned(opened(SOUND), SOUND)
    assert CASE.error(good.estimate.base_T_correction) < INITIAL / 2
    broken = scanned(good, make_stuck_finger(SOUND))
    before = good
    if not broken.estimate.sensor_problem:  # a second over a level surface tells nothing
        before, broken = broken, scanned(broken, make_stuck_finger(SOUND))
    assert broken.estimate.sensor_problem
    assert broken.state is State.AWAITING_SCAN
    assert broken.estimate.base_T_correction.is_close(before.estimate.base_T_correction)
    assert broken.registrable_scans == before.registrable_scans
    assert CASE.error(broken.estimate.base_T_correction) < INITIAL / 2
    mended = scanned(broken, SOUND)
    assert not mended.estimate.sensor_problem
    assert len(mended.registrable_scans) == len(before.registrable_scans) + 1
    assert mended.estimate.samples > before.estimate.samples


def test_a_session_goes_on_from_its_stored_record(tmp_path: Path) -> None:
    first = opened(make_stuck_finger(SOUND))
    second = scanned(first, make_stuck_finger(SOUND))

    async def stored() -> Record:
        async with open_store(tmp_path) as store:
            await store.update(await store.create("", first, [], None), second, [NewEvent("session", {})], None)
        async with open_store(tmp_path) as store:
            return await store.load_record("", "s", None)

    loaded = asyncio.run(stored())
    assert loaded.estimate.sensor_problem == second.estimate.sensor_problem != ""
    assert [len(beams) for beams in loaded.measured] == [0]
    ends = [scanned(record, make_stuck_finger(SOUND)).to_session() for record in (second, loaded)]
    assert json.session_to_json(ends[0]) == json.session_to_json(ends[1])
    assert ends[0].state is State.EXHAUSTED


def test_one_stuck_module_of_six_is_left_out() -> None:
    finger = make_stuck_module(SOUND)
    record = opened(finger)
    sent = scan(record, finger)
    (diagnosis,) = diagnose(sent, finger.sensor, record.scene, record.estimate)
    assert (diagnosis.module, diagnosis.fault) == (5, Fault.STUCK)
    after = scanned(record, finger)
    assert not after.estimate.sensor_problem
    assert CASE.error(after.estimate.base_T_correction) < INITIAL / 2
    assert len(after.measured[0]) == len(sent) * 5 // 6
    assert after.scans[0].samples == len(sent)


MESHES = {"box": box(), "bowl": bowl(), "can": can(), "drill": drill(), "mug": mug()}
FINGERS = {
    "ideal": SOUND,
    "vl6180x": realise(FingerModel.VL6180X, generator("vl6180x")),
    "cone": realise(FingerModel.CONE, generator("cone")),
    **{f"random-{k}": realise(FingerModel.RANDOM, generator("random", k)) for k in range(3)},
}


@pytest.mark.parametrize("name", MESHES)
def test_a_sound_finger_is_never_doubted(name: str) -> None:
    mesh: Mesh = MESHES[name]
    case = make_case(name, mesh, 1)
    for finger in FINGERS.values():
        record = opened(finger, case)
        sent = scan(record, finger, case)
        assert diagnose(sent, finger.sensor, record.scene, record.estimate) == ()
