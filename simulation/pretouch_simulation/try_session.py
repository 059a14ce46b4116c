"""A session on one depth image without a robot: what the services would find, and plan first, in this process."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pretouch_orchestrator.perception.segmentation import find_object
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_orchestrator.sessions.record import Record
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar

from pretouch.camera import Camera, DepthImage
from pretouch.geometry import Array, Plane, Pose
from pretouch.session import SessionRequest, Tolerance
from pretouch_simulation.in_process import InProcessDetector, InProcessRegistrar

LEVEL = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
"""The table in the base that `level_base` makes."""


@dataclass(frozen=True, eq=False)
class OwnImage:
    """A depth image as a user has it.

    Attributes:
        mask: (h, w), True on the object; None: it is found on the table.
        roi: (u0, v0, u1, v1), half-open: the object is within it.
        table: in the camera frame, normal towards the camera; None: it is found.
        at: (k, 3), m, in the camera frame, where the error counts; None: at the object's visible points.
    """

    depth: DepthImage
    camera: Camera
    mask: NDArray[np.bool_] | None = None
    roi: tuple[int, int, int, int] | None = None
    table: Plane | None = None
    at: Array | None = None


def level_base(image: OwnImage) -> Pose:
    """A base_T_camera that nobody has measured: z up from the table, its origin on the table below the camera.

    x is as near to the camera's x as can be.

    Raises:
        InvalidInput: no depth, no table, no object, or a mask or roi that does not fit.
    """
    found = find_object(image.depth, image.camera, Pose.identity(), image.roi, image.mask, image.table)
    return found.scene.table.frame().inverse()


def open_session(image: OwnImage) -> Record:
    """The session as the services would open it, with defaults, in the base of `level_base`.

    Raises:
        InvalidInput: as `level_base`.
    """
    base_T_camera = level_base(image)
    at = None if image.at is None else base_T_camera.apply(image.at)
    request = SessionRequest(
        image.camera, base_T_camera, depth_scale=1.0, roi=image.roi, table=LEVEL, tolerance=Tolerance(at=at)
    )
    loop = Loop(InProcessDetector(), InProcessRegistrar(Engine.POSTERIOR, Registrar()))
    return asyncio.run(loop.open("try", time.time(), request, image.depth, image.mask))
