"""Fingertips of several modules in sessions: they work as one; a module that sees the robot is left out."""

import asyncio
from dataclasses import replace

import numpy as np
import pytest
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar, Settings
from pretouch_simulation.evaluation import run_session
from pretouch_simulation.evaluation_protocol import Protocol, loop_of, request_of
from pretouch_simulation.finger import Finger, FingerModel, realise
from pretouch_simulation.fingers.faults import Broken
from pretouch_simulation.fingers.several import Several
from pretouch_simulation.fingers.vl6180x import VL6180X
from pretouch_simulation.objects import box
from pretouch_simulation.protocol import make_case

from pretouch.estimate import from_prior
from pretouch.geometry import Array, Pose
from pretouch.scan_prediction import Candidate, Prediction
from pretouch.session import Planner, Proposer

REGISTRAR = Registrar()
CASE = make_case("box", box(), 0)
PAD = 5
"""The gripper's module that looks from its pad to the other finger."""


def protocol_of(model: FingerModel) -> Protocol:
    return Protocol(2, Proposer.RANDOM, Engine.POSTERIOR, Planner.INFORMATION, model, seed=0)


@pytest.mark.parametrize("model", [FingerModel.GRIPPER, FingerModel.ZONES])
def test_a_session_corrects_the_pose_by_all_modules(model: FingerModel) -> None:
    steps = asyncio.run(run_session(CASE, protocol_of(model), REGISTRAR))
    record = steps[-1].record
    sensor = record.request.sensor
    for scan in record.scans:
        assert scan.samples % len(sensor.tip_T_module) == 0
        assert scan.samples >= scan.duration * sensor.rate * len(sensor.tip_T_module)
    assert len(record.measured[0]) == record.scans[0].samples
    assert CASE.is_covered_by(record.estimate)
    assert CASE.error(record.estimate.base_T_correction) < 0.010
    assert record.estimate.expected_error < 0.6 * from_prior(record.prior, record.scene.cloud).expected_error


def test_a_module_that_sees_the_other_finger_does_not_spoil_the_answer() -> None:
    def see_finger(ranges: Array, chance: Array) -> Array:
        return 0.014 + 0.002 * chance

    whole = realise(FingerModel.GRIPPER, np.random.default_rng(0))
    fingers = (*(VL6180X(),) * PAD, Broken(VL6180X(), see_finger))
    facing: Finger = Several(whole.sensor, fingers)
    (step,) = asyncio.run(run_session(CASE, protocol_of(FingerModel.GRIPPER), REGISTRAR, upto=1, finger=facing))
    record = step.record
    modules = len(whole.sensor.tip_T_module)
    assert len(record.measured[0]) == record.scans[0].samples * PAD // modules
    assert record.estimate.sensor_problem == ""
    assert CASE.is_covered_by(record.estimate)


def test_predictions_count_all_modules() -> None:
    protocol = protocol_of(FingerModel.IDEAL)
    loop = loop_of(protocol, REGISTRAR)
    record = asyncio.run(loop.open("s", 0.0, request_of(CASE, protocol), CASE.depth, CASE.mask))
    assert record.next_scan is not None
    candidate = Candidate(record.next_scan.path)
    one = record.request.sensor
    apart = tuple(Pose.of(np.eye(3), [x, 0.0, 0.0]) for x in (-0.02, 0.0, 0.02))
    sideways = Pose.from_rotation_vector([0.0, -np.pi / 2, 0.0], np.zeros(3))

    def predict(*modules: Pose) -> Prediction:
        settings = Settings(sensor=replace(one, tip_T_module=modules))
        return REGISTRAR.predict(record.scene, [], settings, [candidate])[0][0]

    single = predict(Pose.identity())
    assert predict(*apart).expected_error < predict(Pose.identity(), sideways, sideways).expected_error
    assert predict(Pose.identity(), sideways).expected_returns == pytest.approx(0.5 * single.expected_returns, abs=0.12)
