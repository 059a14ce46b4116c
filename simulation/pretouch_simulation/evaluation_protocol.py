"""The settings of an evaluation, and the parts of a session that follow from them."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pretouch_orchestrator.sessions.loop import Loop
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar

from pretouch.session import Budget, Planner, Proposer, ScanSettings, SessionRequest, Tolerance
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.finger import Finger, FingerModel, realise
from pretouch_simulation.in_process import InProcessDetector, InProcessRegistrar
from pretouch_simulation.protocol import Case, generator

NEVER_CONVERGED = 1e-6
"""m: a tolerance that no estimate meets."""


@dataclass(frozen=True)
class Protocol:
    """The settings; two runs with equal settings give equal rows, apart from `compute_ms`.

    Attributes:
        scans, seconds, fraction: the budget; left out, only the number of scans counts.
        proposer: None lets the detector choose.
        tolerance: m; a session that reaches it stops.
        paper_setting: the paper's own way of testing, see `paper_setting.py`.
        leader: the engine whose estimates the scans are planned by, so that all engines match the same scans; None:
            the whole loop runs on `engine`.
        camera: of views of meshes.
        guarded: whether the robot guards its scans, see `scan.guarded`.
        stop: whether the robot tells its samples as it moves, and leaves the path once they are enough.
    """

    scans: int
    proposer: Proposer | None
    engine: Engine
    planner: Planner
    sensor: FingerModel
    seed: int
    tolerance: float = NEVER_CONVERGED
    paper_setting: bool = False
    leader: Engine | None = None
    camera: CameraModel = CameraModel.KINECT
    seconds: float = 1e6
    fraction: float = 1.0
    guarded: bool = False
    stop: bool = False


def adopt_default_budget(protocol: Protocol) -> Protocol:
    """The protocol with the budget of a session that asks for none."""
    budget = Budget()
    return replace(protocol, scans=budget.scans, seconds=budget.seconds, fraction=budget.fraction)


def adapt_to_frames(protocol: Protocol, tolerance: float | None) -> Protocol:
    """The protocol for real frames: default budgets, and the default tolerance unless `tolerance`, m, is given.

    Random numbers are seeded by the tasks alone, so that a row does not depend on the other seeds of the evaluation.
    """
    return replace(adopt_default_budget(protocol), tolerance=tolerance or Tolerance().error, seed=0)


def can_stop_in_time(protocol: Protocol) -> bool:
    """Whether the protocol's scans may end early by default: its sessions can converge, and plan by information."""
    return protocol.tolerance != NEVER_CONVERGED and protocol.planner is Planner.INFORMATION


def finger_of(case: Case, protocol: Protocol) -> Finger:
    """The fingertip of the protocol's run on `case`: one for all of its scans."""
    return realise(protocol.sensor, generator("finger-model", protocol.seed, case.name, case.view))


def request_of(case: Case, protocol: Protocol) -> SessionRequest:
    """What a client asks for."""
    return SessionRequest(
        camera=case.camera,
        base_T_camera=case.base_T_camera,
        depth_scale=1.0,
        tolerance=Tolerance(error=protocol.tolerance),
        budget=Budget(scans=protocol.scans, seconds=protocol.seconds, fraction=protocol.fraction),
        sensor=finger_of(case, protocol).sensor,
        scan=ScanSettings(guarded=protocol.guarded),
        proposer=protocol.proposer,
        planner=protocol.planner,
    )


def loop_of(protocol: Protocol, registrar: Registrar) -> Loop:
    """The orchestrator's own loop over the services' own code."""
    return Loop(InProcessDetector(), InProcessRegistrar(protocol.engine, registrar))
