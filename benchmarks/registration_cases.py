"""Registration cases made by simulation: one scan of a random rectangle, as the paper's Algorithm 1 makes its labels.

The source is cut out of the camera's own cloud, moved to its true place, where it projects onto the rectangle's
perimeter, with Gaussian noise of 1.5 mm; the target is the camera's cloud near that perimeter. (Lancaster, Yang, Smith,
IROS 2017.) Points are in base; everything random is fixed by the seed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pretouch_detector.proposals.random import draw_candidates
from pretouch_registrar.engines import camera_model
from pretouch_registrar.engines.camera_model import CameraModel
from pretouch_simulation.mesh import Mesh, load_mesh
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import TABLE, generator, make_case

from pretouch.geometry import Array, Pose
from pretouch.scene import Scene

NOISE = 0.0015
"""m, of the source."""
ON_PERIMETER = 0.75
"""px: half the width of the source's band; one to two points a pixel, as a finger at 5 cm/s and 30 Hz gives."""
NEAR_PERIMETER = 5.0
"""px: half the width of the target's band."""
MIN_SOURCE, MIN_TARGET = 30, 60
_SCANS_PER_VIEW = 4
_MARGIN = 0.1


@dataclass(frozen=True, eq=False)
class RegistrationCase:
    """One scan to be matched.

    Attributes:
        source: (n, 3), m, the scan, where it truly is.
        target: (m, 3), m, the camera's points near the rectangle, where the camera puts them.
        normals: (m, 3) of the target, unit, towards the camera.
        target_T_source: what a match should find.
        model: what the camera saw, cropped around the object.
    """

    name: str
    source: Array
    target: Array
    normals: Array
    target_T_source: Pose
    model: CameraModel

    def error(self, target_T_source: Array) -> float:
        """m: mean distance of the source, matched by a 4x4, from its true match: the paper's score."""
        matched = self.source @ target_T_source[:3, :3].T + target_T_source[:3, 3]
        return float(np.linalg.norm(matched - self.target_T_source.apply(self.source), axis=1).mean())

    def object_error(self, base_T_correction: Pose) -> float:
        """m: the same over all the object's points and for a correction, which is the inverse of a match."""
        cloud = self.model.scene.cloud
        truth = self.target_T_source.inverse()
        return float(np.linalg.norm(base_T_correction.apply(cloud) - truth.apply(cloud), axis=1).mean())


def make_cases(count: int, seed: int = 0, meshes: Path | None = None) -> list[RegistrationCase]:
    """`count` cases over the objects made in code, or over a folder of meshes; views of all objects take turns."""
    cases: list[RegistrationCase] = []
    view = 0
    while len(cases) < count:
        for name, mesh in _meshes(meshes):
            cases += _make_view_case(name, mesh, view, seed)
            if len(cases) >= count:
                break
        view += 1
    return cases[:count]


def _meshes(folder: Path | None) -> Iterator[tuple[str, Mesh]]:
    if folder is None:
        yield from ((name, maker()) for name, maker in MAKERS.items())
    else:
        yield from ((path.stem, load_mesh(path)) for path in meshes_in(folder))


def _make_view_case(name: str, mesh: Mesh, view: int, seed: int) -> list[RegistrationCase]:
    case = make_case(name, mesh, view, seed)
    table = TABLE.moved(case.truth.inverse())
    scene, _ = Scene(case.depth, case.camera, case.base_T_camera, case.mask, table).cropped(_MARGIN)
    model = camera_model.build(scene)
    rng = generator("registration benchmark", seed, name, view)
    v, u = np.nonzero(scene.mask)
    normals = model.pixels.surface.normals[scene.mask].astype(np.float64)
    true_cloud = case.truth.apply(scene.cloud)
    seen_at = scene.camera.project(scene.base_T_camera.inverse().apply(true_cloud))
    cases = []
    for rectangle in draw_candidates(scene, _SCANS_PER_VIEW, rng):
        on = np.abs(rectangle.distance(seen_at)) <= ON_PERIMETER
        near = np.abs(rectangle.distance(np.stack([u, v], axis=1))) <= NEAR_PERIMETER
        source = true_cloud[on] + rng.normal(0.0, NOISE, (on.sum(), 3))
        if len(source) >= MIN_SOURCE and near.sum() >= MIN_TARGET:
            cases.append(
                RegistrationCase(
                    f"{name}-{view}", source, scene.cloud[near], normals[near], case.truth.inverse(), model
                )
            )
    return cases
