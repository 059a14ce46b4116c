"""A robot's cell in simulation before real services: `pretouch up` as processes, and a finger on a serial line.

with SimulatedCell("mug") as cell:
    for session in cell.session():       # as it was opened, and after each scan
        httpx.get(f"{cell.rest}/v1/sessions/{session.id}")
    cell.move(plan)                      # the finger's device measures along a plan, in real time

The session's samples are computed, so that they do not depend on how busy the machine is.
"""

from __future__ import annotations

import tempfile
from collections.abc import Generator
from contextlib import ExitStack
from pathlib import Path
from typing import Self

from pretouch_simulation.demo import request_for
from pretouch_simulation.finger import FingerModel, realise
from pretouch_simulation.finger_link import FingerProcess
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import generator, make_case
from pretouch_simulation.robot import GatewayRobot
from pretouch_simulation.scanning import scan_along
from pretouch_simulation.services import Services

from pretouch.client import RestClient, drive
from pretouch.session import Budget, ScanPlan, Session, Tolerance
from pretouch.tof import RangeSamples


class SimulatedCell:
    """One object of the demo's, by its name; the robot's device is called `finger`."""

    def __init__(self, object_name: str) -> None:
        self._case = make_case(object_name, MAKERS[object_name](), 0)
        self._finger = realise(FingerModel.IDEAL, generator("finger-model", 0))
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        with self._stack:
            world = Path(self._stack.enter_context(tempfile.TemporaryDirectory())) / "world.npz"
            self._case.world.save(world)
            process = FingerProcess.in_world(world, FingerModel.IDEAL.value, 0, self._finger.sensor.rate)
            self._device = self._stack.enter_context(process)
            self._services = self._stack.enter_context(Services([f"finger={process.port}"]))
            self._stack = self._stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def rest(self) -> str:
        """URL of the orchestrator."""
        return self._services.rest

    def session(self, tolerance: float = 0.005, scans: int = 10) -> Generator[Session]:
        """A session with this tolerance, m, and at most so many scans: as it was opened, then after each scan."""
        budget = Budget(scans=scans, fraction=1.0)
        request = request_for(self._case, self._finger.sensor, budget, Tolerance(error=tolerance))
        with RestClient(self.rest, timeout=60) as client:
            session = client.create_session(request, self._case.depth.metres, self._case.mask)
            yield from drive(client, session, self._scan)

    def move(self, plan: ScanPlan) -> None:
        """Moves the finger along the plan, as fast as planned; its device measures."""
        with GatewayRobot(self._device, self._services.gateway, "finger") as robot:
            robot.scan(plan)

    def _scan(self, plan: ScanPlan) -> RangeSamples:
        rng = generator("finger", plan.scan_id)
        return scan_along(self._case.world, plan.path, self._finger.sensor, self._finger, rng)
