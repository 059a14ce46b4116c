"""The session that the contract tests open: a box on a table, seen by a camera, scanned by an exact finger."""

from __future__ import annotations

from typing import Any

import numpy as np

from helpers.scenes import Box, View, World
from pretouch.session import ScanPlan, SessionRequest
from pretouch.tof import RangeSamples, Sensor

WORLD = World((Box.standing((0.08, 0.06, 0.05)),))
VIEW = View()
DEPTH_SCALE = 0.0001
_image, MASK = WORLD.depth(VIEW)
DEPTH = np.round(_image.metres / DEPTH_SCALE).astype(np.uint16)
TOKEN = "correct-horse"
"""Of the guarded orchestrator."""
ROOMY = {"scans": 20, "seconds": 100_000.0, "fraction": 1.0}
"""A budget that no test exhausts by accident."""


def request(**changes: Any) -> SessionRequest:
    """What the client asks for; the object's mask goes along apart."""
    return SessionRequest(camera=VIEW.camera, base_T_camera=VIEW.base_T_camera, depth_scale=DEPTH_SCALE, **changes)


def measured(plan: ScanPlan) -> RangeSamples:
    """The finger's samples along the plan."""
    return WORLD.scanned(plan.path, Sensor())
