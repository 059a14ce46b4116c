"""The registration engines: one interface, and a module for each."""

from __future__ import annotations

from enum import StrEnum
from importlib import import_module

from pretouch_registrar.engines.camera_model import CameraModel
from pretouch_registrar.engines.registration_problem import RegistrationProblem
from pretouch_registrar.engines.resources import Resources
from pretouch_registrar.engines.solution import Solution


class Engine(StrEnum):
    """The engines; each is the module of its name, which describes it and has its `solve`."""

    POSTERIOR = "posterior"
    POINT_TO_PLANE = "point_to_plane"
    PAPER = "paper"
    PCL = "pcl"


def solve(engine: Engine, problem: RegistrationProblem, model: CameraModel, resources: Resources) -> Solution:
    """The engine's answer to the problem, which is of the scene that `model` is of."""
    solution: Solution = import_module(f"{__name__}.{engine.value}").solve(problem, model, resources)
    return solution
