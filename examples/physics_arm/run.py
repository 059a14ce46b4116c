"""One run: a robot that sees an object, asks pretouch where to look, scans, and ends with a better pose."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from examples.physics_arm.camera import DEPTH_UNIT, INTRINSICS, photograph
from examples.physics_arm.finger import SENSOR, Finger
from examples.physics_arm.robot import Robot
from examples.physics_arm.truth import Truth
from examples.physics_arm.world import World
from pretouch.client import RestClient, drive
from pretouch.geometry import Pose
from pretouch.session import ScanSettings, SessionRequest, State, Tolerance


@dataclass(frozen=True)
class Result:
    """How a run ended; lengths in m."""

    object_name: str
    seed: int
    initial_error: float
    error: float
    expected_error: float
    covered: bool
    state: State
    scans: int
    skipped: int
    touches: int
    seconds: float


def run(client: RestClient, object_name: str, seed: int, tolerance: Tolerance) -> Result:
    """Opens a session with what the camera shows and the robot believes, and scans until the session ends."""
    random = np.random.default_rng([zlib.crc32(object_name.encode()), seed])
    world = World.of(object_name, random)
    view = photograph(world, random)
    truth = Truth.hidden(view, random)
    robot = Robot(world, Finger(world, random))

    request = SessionRequest(
        INTRINSICS,
        truth.believed,
        depth_scale=DEPTH_UNIT,
        tolerance=tolerance,
        sensor=SENSOR,
        scan=ScanSettings(guarded=True),
    )
    session = client.create_session(request, view.depth)
    *_, session = drive(client, session, robot.scan)
    estimate = session.estimate
    return Result(
        object_name,
        seed,
        initial_error=truth.error(Pose.identity()),
        error=truth.error(estimate.base_T_correction),
        expected_error=estimate.expected_error,
        covered=truth.is_covered(estimate),
        state=session.state,
        scans=session.budget_used.scans,
        skipped=robot.skipped,
        touches=robot.touches,
        seconds=session.budget_used.seconds,
    )
