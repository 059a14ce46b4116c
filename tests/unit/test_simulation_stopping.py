"""Evaluated sessions stop a scan once its samples are enough, by the services' own code."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import numpy as np
import pytest
from helpers.loop_fakes import FormulaRegistrar, RandomDetector, answer, asked, opened, samples_of
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_orchestrator.sessions.record import Record
from pretouch_registrar.engines import Engine
from pretouch_simulation.evaluation_protocol import NEVER_CONVERGED, Protocol, can_stop_in_time
from pretouch_simulation.finger import FingerModel
from pretouch_simulation.robot_motion import PIECE
from pretouch_simulation.scanning import cut_pieces
from pretouch_simulation.stopping import NOTHING, tell_until_enough

from pretouch.session import Budget, Planner, State
from pretouch.tof import RangeSamples

ROOMY = Budget(4, 1e5, 1.0)


def flown(gain: float) -> tuple[Loop, Record, RangeSamples]:
    """A loop, and its session with the samples told that were flown, of those given."""
    loop = Loop(RandomDetector(6), FormulaRegistrar(gain))
    record = opened(loop, asked(budget=ROOMY))
    samples = samples_of(record)
    return loop, asyncio.run(tell_until_enough(loop, record, samples)), samples


def test_pieces_are_a_quarter_of_a_second_each_and_together_all_samples() -> None:
    _, _, samples = flown(1e-9)
    pieces = cut_pieces(samples)
    whole = RangeSamples.concatenate(pieces)
    np.testing.assert_array_equal(whole.t, samples.t)
    assert all(piece.t[-1] - piece.t[0] < PIECE for piece in pieces)
    assert len(pieces) == pytest.approx((samples.t[-1] - samples.t[0]) / PIECE, abs=1)
    assert cut_pieces(NOTHING) == []


def test_a_scan_is_left_once_the_session_would_converge() -> None:
    loop, record, samples = flown(0.3)
    assert 20 <= len(record.told_samples) < len(samples) / 2
    after = answer(loop, record, NOTHING)
    assert after.state is State.CONVERGED
    assert after.budget_used.seconds == pytest.approx(record.told_samples.t[-1] - samples.t[0])


def test_a_scan_that_is_never_enough_is_flown_to_its_end() -> None:
    loop, record, samples = flown(1e-9)
    assert len(record.told_samples) == len(samples)
    assert answer(loop, record, NOTHING).state is State.AWAITING_SCAN


def test_by_default_sessions_stop_where_they_can_converge_and_plan_by_information() -> None:
    protocol = Protocol(5, None, Engine.POSTERIOR, Planner.INFORMATION, FingerModel.IDEAL, 0)
    assert protocol.tolerance == NEVER_CONVERGED
    assert not can_stop_in_time(protocol)
    assert can_stop_in_time(replace(protocol, tolerance=0.003))
    assert not can_stop_in_time(replace(protocol, tolerance=0.003, planner=Planner.CONFIDENCE))
