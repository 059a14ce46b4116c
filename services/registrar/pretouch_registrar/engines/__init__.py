"""The registration engines: one interface, and a module for each."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum

from pretouch_registrar.engines import paper, pcl, point_to_plane, posterior
from pretouch_registrar.engines.camera_model import CameraModel
from pretouch_registrar.engines.registration_problem import RegistrationProblem
from pretouch_registrar.engines.resources import Resources
from pretouch_registrar.engines.solution import Solution


class Engine(StrEnum):
    """The engines; each is described in the module of its name."""

    POSTERIOR = "posterior"
    POINT_TO_PLANE = "point_to_plane"
    PAPER = "paper"
    PCL = "pcl"


SOLVERS: dict[Engine, Callable[[RegistrationProblem, CameraModel, Resources], Solution]] = {
    Engine.POSTERIOR: posterior.solve,
    Engine.POINT_TO_PLANE: point_to_plane.solve,
    Engine.PAPER: paper.solve,
    Engine.PCL: pcl.solve,
}
