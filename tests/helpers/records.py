"""Session records with every member set, with numbers that any rounding would change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pretouch_orchestrator.sessions.record import Record

from helpers import box_view, fake_upstream
from pretouch.camera import DepthImage
from pretouch.errors import Internal, problem
from pretouch.estimate import Mode
from pretouch.geometry import Plane, Pose
from pretouch.prior import Prior
from pretouch.rectangle import RotatedRectangle
from pretouch.scene import Scene
from pretouch.session import BudgetUsed, Proposer, Region, ScanPlan, ScanSummary, State
from pretouch.tof import RangeSamples, Scan
from pretouch.trajectory import Trajectory
from pretouch.wire import json


def a_record(session_id: str = "one") -> Record:
    request = json.request_from_json(
        box_view.request(
            base_T_object=json.pose_to_json(Pose.from_rotation_vector([0.1, 0.2, 0.3], [0.45, 0.01, 0.02])),
            sensor={"tip_T_module": [json.pose_to_json(Pose.from_rotation_vector([0, 0.7, 0], [0.001, 0, 1 / 3]))]},
            roi=[10, 20, 300, 200],
            prior={
                "base_T_correction": json.pose_to_json(Pose.from_rotation_vector([0, 0.01, 0.03], [0.01, 0, 1 / 300])),
                "covariance": (np.diag([3e-4, 4e-4, 5e-4, 3e-5, 4e-5, 5e-5]) + 1e-5 / 3).tolist(),
            },
            proposer="random",
        )
    )
    depth, mask = box_view.depth_and_mask()
    whole = Scene(
        DepthImage.from_values(depth, request.depth_scale),
        request.camera,
        request.base_T_camera,
        mask > 0,
        Plane(np.array([0.0, 0.1, 1.0]) / np.sqrt(1.01), -1e-3 / 3),
    )
    scene, origin = whole.cropped(0.05)
    estimate = fake_upstream.estimate(scene, 1, 40, request.prior or Prior())
    other = Pose.from_rotation_vector([0, 0.2, 0], [0.01, 0, 0])
    tip = np.stack([Pose.from_rotation_vector([0, 0.1 * k, 0.3], [k / 3, 0, 0.1]).matrix for k in range(4)])
    return Record(
        id=session_id,
        created=1.7e9 + 1 / 3,
        request=request,
        scene=scene,
        origin=origin,
        proposer=Proposer.RANDOM,
        regions=(Region("r1", RotatedRectangle(160.1, 120.2, 30, 20, 0.3), 0.9, 0.011),),
        estimate=replace(
            estimate,
            modes=(
                Mode(estimate.base_T_correction, 2 / 3),
                Mode(other, 1 / 3),
            ),
            fit=1 / 3,
            sensor_problem="All 40 ranges are 31.2 mm: the sensor is stuck.",
        ),
        next_scan=ScanPlan("s2", "line-3", None, Trajectory(np.arange(4) / 3, tip), 0.7),
    )


def after_telling(record: Record, count: int = 3) -> Record:
    """`count` more samples of the next scan are told."""
    start = len(record.told_samples)
    t = (start + np.arange(count)) / 3
    poses = np.tile(Pose.from_rotation_vector([0, 0.1, 0.3], [1 / 3, 0, 0.1]).matrix, (count, 1, 1))
    ranges = np.where(np.arange(count) % 2, np.nan, 0.1 / 3)
    codes = np.arange(start, start + count)
    return replace(record, told=(*record.told, RangeSamples(t, poses, ranges, codes, codes)))


def after_a_scan(record: Record) -> Record:
    beams = Scan(np.full((3, 3), 1 / 3), np.tile([0.0, 0.0, -1.0], (3, 1)), np.array([0.03, np.nan, 0.1 / 3]))
    return replace(
        record,
        state=State.FAILED,
        next_scan=None,
        scans=(*record.scans, ScanSummary("s2", "line-3", None, 3, 2, 0.1, 2.0, 0.01)),
        measured=(*record.measured, beams),
        told=(),
        skipped=("r7",),
        answered=("s1", "s2"),
        budget_used=BudgetUsed(1, 2.0, 0.1),
        reason=problem(Internal("a defect", "report it")),
    )
