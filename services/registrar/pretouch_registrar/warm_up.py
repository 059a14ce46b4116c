"""Compiles or loads the kernels before the first request, on a small synthetic scene."""

from __future__ import annotations

import numpy as np

from pretouch.camera import Camera, DepthImage
from pretouch.geometry import Plane, Pose
from pretouch.mesh_target import MeshTarget
from pretouch.scan_prediction import Candidate
from pretouch.scene import Scene
from pretouch.tof import Scan
from pretouch.trajectory import Trajectory
from pretouch_registrar.engines import Engine
from pretouch_registrar.mesh_scene import mesh_scene
from pretouch_registrar.registration import Registrar, Settings


def warm_up(registrar: Registrar) -> None:
    """Runs each kernel of every engine once, with the argument types of real requests."""
    depth = np.full((40, 40), 0.8, dtype=np.float32)
    depth[12:28, 12:28] = 0.75
    base_T_camera = Pose.of(np.diag([1.0, -1.0, -1.0]), [0, 0, 0.8])
    scene = Scene(
        DepthImage(depth),
        Camera(400, 400, 19.5, 19.5),
        base_T_camera,
        depth < 0.78,
        Plane(np.array([0.0, 0.0, 1.0]), 0.0),
    )
    tip = np.tile(np.eye(4), (24, 1, 1))
    tip[:, :3, :3] = np.diag([1.0, -1.0, -1.0])
    tip[:, 0, 3] = np.linspace(-0.03, 0.03, 24)
    tip[:, 1, 3] = 0.01 * np.cos(np.arange(24))
    tip[:, 2, 3] = 0.08
    ranges = np.where(np.abs(tip[:, 0, 3]) < 0.015, 0.03, 0.08)
    ranges[0] = np.nan
    scan = Scan(tip[:, :3, 3], tip[:, :3, 2], ranges)
    for engine in Engine:
        registrar.register(scene, [scan], Settings(engine))
    triangle = np.array([[0.0, 0.0, 0.05], [0.05, 0.0, 0.05], [0.0, 0.05, 0.05]])
    mesh_scene(MeshTarget(triangle, np.array([[0, 1, 2]]), Pose.identity(), scene.table))
    registrar.predict(scene, [scan], Settings(), [Candidate(Trajectory(np.arange(24.0), tip))])
