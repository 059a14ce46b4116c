"""The evaluation's cases with a known shape: the mesh target, and scans that were not planned."""

from __future__ import annotations

import numpy as np
from pretouch_simulation.fingers.ideal import ThinBeam
from pretouch_simulation.protocol import PLACE, TABLE, Case, generator
from pretouch_simulation.scanning import scan_along

from pretouch.mesh_target import MeshTarget
from pretouch.tof import Scan
from pretouch.trajectory import Trajectory


def mesh_target_of(case: Case) -> MeshTarget:
    """The object's mesh and the table where the miscalibrated camera puts them."""
    body, believed = case.world.bodies[0], case.truth.inverse()
    return MeshTarget(body.mesh.vertices, body.mesh.faces, believed @ body.base_T_mesh, TABLE.moved(believed))


def blind_scans(case: Case, count: int = 4) -> list[Scan]:
    """Random straight scans across the object's true place, 35 mm above its top."""
    extents = case.world.bodies[0].mesh.extents
    finger, reach = ThinBeam(), float(extents[:2].max()) / 2 + 0.03
    scans = []
    for k in range(count):
        rng = generator("blind", case.name, case.view, k)
        angle = rng.uniform(0, np.pi) + k * np.pi / 4
        along, beside = np.array([np.cos(angle), np.sin(angle)]), rng.uniform(-0.02, 0.02)
        middle = PLACE[:2] + beside * np.array([-along[1], along[0]])
        tip = np.tile(np.eye(4), (2, 1, 1))
        tip[:, :3, :3] = np.diag([1.0, -1.0, -1.0])
        tip[:, :2, 3] = middle - reach * along, middle + reach * along
        tip[:, 2, 3] = extents[2] + 0.035
        path = Trajectory(np.array([0.0, 2 * reach / 0.05]), tip)
        scans.append(scan_along(case.world, path, finger.sensor, finger, rng).beams(finger.sensor))
    return scans
