"""A session's world in memory: services that answer by formula, and a finger that scans the true boxes.

Helper of `test_loop*.py`; see `fake_upstream.py` for fakes behind gRPC.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_orchestrator.sessions.record import Record

from helpers.scenes import Box, View, World
from pretouch.errors import Unavailable
from pretouch.estimate import Estimate, from_prior, point_error
from pretouch.geometry import Array, Plane, Pose
from pretouch.prior import AnyPrior
from pretouch.rectangle import ProposedRegion, RotatedRectangle
from pretouch.scan_prediction import Candidate, Prediction
from pretouch.scene import Scene
from pretouch.session import Points, Proposer, SessionRequest, Skipped
from pretouch.tof import RangeSamples, Scan, Sensor

WORLD = World((Box.standing((0.09, 0.07, 0.05), (0.01, 0.0), 0.4), Box.standing((0.04, 0.04, 0.03), (0.0, 0.15))))
CORRECTION = Pose.from_rotation_vector((0.01, -0.02, 0.03), (0.008, -0.006, 0.01))
TRUTH = WORLD.moved(CORRECTION)
VIEW = View()
DEPTH, MASK = WORLD.depth(VIEW)
TABLE = Plane(np.array([0.0, 0.0, 1.0]), 0.0)


class RandomDetector:
    """Rectangles about the object, confidences falling; `count` of them."""

    def __init__(self, count: int = 8) -> None:
        self.count = count
        self.scene: Scene | None = None

    async def propose(
        self, scene: Scene, proposer: Proposer | None, sensor: Sensor, seed: int
    ) -> tuple[Proposer, list[ProposedRegion]]:
        self.scene = scene
        rng = np.random.default_rng(seed)
        u0, v0, u1, v1 = scene.bounds()
        regions = []
        for k in range(self.count):
            x, y = rng.uniform((u0, v0), (u1, v1))
            w, h = rng.uniform(0.4, 0.9, 2) * (u1 - u0, v1 - v0)
            regions.append(ProposedRegion(RotatedRectangle(x, y, w, h, rng.uniform(-1.5, 1.5)), 1 - k / 100))
        return proposer or Proposer.RANDOM, regions


class FormulaRegistrar:
    """Knows the correction; each return shrinks the prior's deviations, and long paths get a larger predicted gain.

    Attributes:
        fit, sensor_problem: what it says of any samples.
    """

    def __init__(self, gain: float = 0.05, fit: float = 1.0, sensor_problem: str = "") -> None:
        self.gain = gain
        self.fit = fit
        self.sensor_problem = sensor_problem
        self.down = False

    async def register(
        self, scene: Scene, scans: Sequence[Scan], prior: AnyPrior, sensor: Sensor, at: Array | None = None
    ) -> Estimate:
        if self.down:
            raise Unavailable("The registrar is away.", "Wait.")
        returns = sum(int(scan.returned.sum()) for scan in scans)
        if returns == 0:
            estimate = from_prior(prior, scene.cloud, at)
            return replace(estimate, fit=self.fit, sensor_problem=self.sensor_problem) if scans else estimate
        covariance = prior.covariance / (1 + self.gain * returns) ** 2
        about = Pose.of(CORRECTION.rotation, CORRECTION.translation)
        expected, quantile = point_error(
            covariance, about.apply(scene.cloud if at is None else at), about.apply(scene.centroid)
        )
        return Estimate(
            about,
            scene.centroid,
            covariance,
            expected,
            float(quantile[0]),
            samples=returns,
            fit=self.fit,
            sensor_problem=self.sensor_problem,
        )

    async def predict(
        self,
        scene: Scene,
        scans: Sequence[Scan],
        prior: AnyPrior,
        sensor: Sensor,
        candidates: Sequence[Candidate],
        at: Array | None = None,
    ) -> list[list[Prediction]]:
        present = (await self.register(scene, scans, prior, sensor, at)).expected_error
        return [
            [Prediction(present / (1 + each.path.between(*piece).length), 1.0) for piece in each.pieces]
            for each in candidates
        ]


def asked(**changes: Any) -> SessionRequest:
    return replace(SessionRequest(VIEW.camera, VIEW.base_T_camera, table=TABLE), **changes)


def opened(loop: Loop, request: SessionRequest) -> Record:
    return asyncio.run(loop.open("s", 0.0, request, DEPTH, MASK))


def answer(loop: Loop, record: Record, submission: RangeSamples | Points | Skipped) -> Record:
    assert record.next_scan is not None
    return asyncio.run(loop.advance(record, record.next_scan.scan_id, submission))


def samples_of(record: Record) -> RangeSamples:
    assert record.next_scan is not None
    return TRUTH.scanned(record.next_scan.path, record.request.sensor)


def misses(n: int, span: float = 1.0) -> RangeSamples:
    """Without a return, from too far above the object."""
    poses = np.tile(Pose.of(np.diag([1.0, -1.0, -1.0]), (0.01, 0.0, 0.3)).matrix, (n, 1, 1))
    return RangeSamples(np.linspace(0, span, n), poses, np.full(n, np.nan), np.full(n, 7), np.zeros(n, dtype=int))
