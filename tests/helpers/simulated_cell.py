"""A simulated robot's cell before real services: `pretouch up` as processes, and a finger on a serial line.

with SimulatedCell("mug") as cell:
    for recording in cell.session():     # after the creation, and after each scan
        recording.last                   # httpx.get(f"{cell.rest}/v1/sessions/{recording.last.id}")
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Self

from pretouch_simulation.demo import Recording, record, request_for
from pretouch_simulation.finger import FingerModel, realise
from pretouch_simulation.finger_link import FingerProcess
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import generator, make_case
from pretouch_simulation.robot import GatewayRobot
from pretouch_simulation.services import Services

from pretouch.client import RestClient
from pretouch.session import Budget, Tolerance

PACE = 8.0
"""How many times as fast as planned the robot moves, and its finger measures."""


class SimulatedCell:
    """One object of the demo's, by its name; the robot's device is called `finger`."""

    def __init__(self, object_name: str) -> None:
        self._case = make_case(object_name, MAKERS[object_name](), 0)
        self._sensor = realise(FingerModel.IDEAL, generator("finger-model", 0)).sensor
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        with self._stack:
            folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory()))
            self._case.world.save(folder / "world.npz")
            rate = PACE * self._sensor.rate
            finger = FingerProcess.in_world(folder / "world.npz", FingerModel.IDEAL.value, 0, rate)
            self._finger = self._stack.enter_context(finger)
            self._services = self._stack.enter_context(Services([f"finger={finger.port}"]))
            self._stack = self._stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def rest(self) -> str:
        """URL of the orchestrator."""
        return self._services.rest

    def session(self, tolerance: float = 0.005, scans: int = 10) -> Iterator[Recording]:
        """A session with this tolerance, m, and at most so many scans: as it was opened, then after each scan."""
        recording = Recording("simulated", self._case, PACE)
        request = request_for(self._case, self._sensor, Budget(scans=scans, fraction=1.0), Tolerance(error=tolerance))
        with (
            GatewayRobot(self._finger, self._services.gateway, "finger", PACE) as robot,
            RestClient(self.rest, timeout=60) as client,
        ):
            yield from record(client, recording, request, True, robot.stream, robot.measured)
