"""After the warm-up no request compiles a kernel, whatever its engine."""

import importlib
import pkgutil

import numpy as np
import pretouch_registrar
import pytest
from helpers.predictions import predict_errors
from helpers.scenes import KINECT, Box, World
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar, Settings
from pretouch_registrar.warm_up import warm_up

from pretouch.tof import Sensor
from pretouch.trajectory import Trajectory

REGISTRAR = Registrar()


def compiled() -> dict[str, int]:
    """How many signatures each kernel of the registrar has been compiled for."""
    counts = {}
    for module in pkgutil.walk_packages(pretouch_registrar.__path__, "pretouch_registrar."):
        for name, value in vars(importlib.import_module(module.name)).items():
            if hasattr(value, "signatures") and hasattr(value, "py_func"):
                counts[f"{module.name}.{name}"] = len(value.signatures)
    return counts


@pytest.mark.parametrize("engine", list(Engine))
def test_the_first_request_compiles_nothing(engine: Engine) -> None:
    warm_up(REGISTRAR)
    before = compiled()
    assert before["pretouch_registrar.engines.icp.align"] == 1
    world = World((Box.standing((0.10, 0.06, 0.05), (0.0, 0.0), 0.4),))
    scene = world.scene(KINECT, np.random.default_rng(5)).cropped(0.1)[0]
    tip = np.tile(np.eye(4), (3, 1, 1))
    tip[:, :3, :3] = np.diag([1.0, -1.0, -1.0])
    tip[:, :2, 3] = (-0.08, -0.01), (0.0, 0.01), (0.02, -0.08)
    tip[:, 2, 3] = 0.085
    path = Trajectory(np.array([0.0, 1.6, 3.4]), tip)
    scan = world.scanned(path, Sensor(), np.random.default_rng(0)).beams(Sensor())
    REGISTRAR.register(scene, [scan], Settings(engine=engine))
    predict_errors(REGISTRAR, scene, [scan], Settings(engine=engine), [path])
    assert compiled() == before
