"""A view as a session sees it, together with its world."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pretouch_orchestrator.perception.preparation import prepare_scene

from pretouch.camera import Camera, DepthImage
from pretouch.geometry import Pose
from pretouch.scene import Scene
from pretouch.session import Planner, SessionRequest
from pretouch.tof import Scan
from pretouch.trajectory import Trajectory
from pretouch_simulation.finger import Finger
from pretouch_simulation.protocol import Case
from pretouch_simulation.scanning import scan_along


@dataclass(frozen=True, eq=False)
class LabelView:
    """One view of an object.

    Attributes:
        case: with the world.
        scene: what a session knows, cropped around the object.
        origin: the scene's first pixel (u0, v0) in the case's image.
    """

    case: Case
    scene: Scene
    origin: tuple[int, int]

    def scan(self, truth: Pose, path: Trajectory, finger: Finger, rng: np.random.Generator) -> Scan:
        """Scans along `path` as if `truth` were the true correction, instead of the case's own.

        Only the object's pose relative to where the camera puts it matters. So the world is moved and not the camera's
        extrinsics, and what was computed from the depth image stays valid.
        """
        world_T_base = self.case.truth @ truth.inverse()
        moved = Trajectory(path.t, world_T_base.matrix @ path.base_T_tip)
        samples = scan_along(self.case.world, moved, finger.sensor, finger, rng)
        return replace(samples, base_T_tip=world_T_base.inverse().matrix @ samples.base_T_tip).beams(finger.sensor)


def view_of(case: Case) -> LabelView:
    """The view that a session makes of the case.

    Raises:
        InvalidInput: no object or no table is found.
    """
    return LabelView(case, *scene_of(case.camera, case.base_T_camera, case.depth, case.mask))


def scene_of(
    camera: Camera, base_T_camera: Pose, depth: DepthImage, mask: NDArray[np.bool_] | None
) -> tuple[Scene, tuple[int, int]]:
    """What a session makes of a depth image: table found, cropped, specks removed; and the first pixel (u0, v0).

    Args:
        mask: (h, w), True on the object; None: the object is segmented.

    Raises:
        InvalidInput: no object or no table is found.
    """
    request = SessionRequest(camera, base_T_camera, depth_scale=1.0, proposer=None, planner=Planner.INFORMATION)
    scene, origin, _ = prepare_scene(request, depth, mask)
    return scene, origin
