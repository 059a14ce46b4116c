"""The paper's own way of testing a region, kept for comparison.

After Lancaster, Yang, Smith, "Improved Object Pose Estimation via Deep Pre-touch Sensing", IROS 2017: the finger's
points are not measured but cut out of the camera's own cloud, moved to its true place, where it projects onto the
region's perimeter; Gaussian noise of 0.15 cm is added. Regions come in the order of confidence, scans accumulate,
and the engine is the paper's. As in all rows the score is over the whole object, not over the points cut out.
"""

from __future__ import annotations

import time

import numpy as np
from pretouch_registrar.registration import Registrar, Settings
from scipy.spatial import cKDTree

from pretouch.geometry import Array
from pretouch.prior import Prior
from pretouch.rectangle import RotatedRectangle
from pretouch.session import State
from pretouch.tof import Scan
from pretouch_simulation.evaluation_protocol import Protocol, loop_of, request_of
from pretouch_simulation.evaluation_rows import Outcome
from pretouch_simulation.protocol import Case, generator

NOISE = 0.0015
"""m."""
ON_PERIMETER = 1.0
"""px: points that project this near to the perimeter count as scanned."""
_SCANNED = 0.005


async def run_case(case: Case, protocol: Protocol, registrar: Registrar) -> list[Outcome]:
    """Scans the first `protocol.scans` regions; an outcome for each, of which the last leaves the session exhausted."""
    request = request_of(case, protocol)
    started = time.perf_counter()
    record = await loop_of(protocol, registrar).open(f"{case.name}-{case.view}", 0.0, request, case.depth, case.mask)
    opening = time.perf_counter() - started
    true_cloud = case.truth.apply(case.cloud)
    settings = Settings(protocol.engine, request.prior or Prior(), request.sensor)
    scans: list[Scan] = []
    outcomes: list[Outcome] = []
    length = 0.0
    regions = sorted(record.regions, key=lambda region: -region.confidence)[: protocol.scans]
    for region in regions:
        rng = generator("paper setting", protocol.seed, case.name, case.view, len(outcomes))
        scans.append(Scan.of_points(cut(case, true_cloud, region.rectangle, rng), -record.scene.table.normal))
        scan_length = perimeter_length(case, region.rectangle)
        length += scan_length
        started = time.perf_counter()
        estimate = registrar.register(record.scene, scans, settings)
        seconds = time.perf_counter() - started + (opening if not outcomes else 0.0)
        outcomes.append(
            Outcome(
                proposer=record.proposer,
                estimate=estimate,
                state=State.AWAITING_SCAN if len(scans) < len(regions) else State.EXHAUSTED,
                fraction=_fraction(true_cloud, scans),
                robot_seconds=length / request.scan.speed,
                scan_seconds=scan_length / request.scan.speed,
                returns=None,
                seconds=seconds,
            )
        )
    return outcomes


def cut(case: Case, true_cloud: Array, rectangle: RotatedRectangle, rng: np.random.Generator) -> Array:
    """(n, 3), m, in base: the noisy points of the moved cloud that the camera, as believed, sees on the perimeter."""
    pixels = case.camera.project(case.base_T_camera.inverse().apply(true_cloud))
    points = true_cloud[np.abs(rectangle.distance(pixels)) <= ON_PERIMETER]
    return np.asarray(points + rng.normal(0.0, NOISE, points.shape), dtype=np.float64)


def perimeter_length(case: Case, rectangle: RotatedRectangle) -> float:
    """m: of the rectangle's perimeter at the object's median depth."""
    depth = float(np.median(case.depth.metres[case.mask]))
    return 2.0 * depth * (rectangle.w + rectangle.h) / case.camera.fx


def _fraction(true_cloud: Array, scans: list[Scan]) -> float:
    points = np.concatenate([scan.points() for scan in scans])
    if not len(points):
        return 0.0
    distances, _ = cKDTree(points).query(true_cloud, distance_upper_bound=_SCANNED)
    return float(np.isfinite(distances).mean())
