"""What cannot be a scene is refused before anything is computed from it."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from helpers.scenes import Box, World

from pretouch.errors import InvalidInput
from pretouch.geometry import Plane, Pose

SCENE = World((Box.standing((0.08, 0.06, 0.05)),)).scene()


@pytest.mark.parametrize(
    "far",
    [
        {"table": Plane(np.array([0.0, 0.0, 1.0]), 1e308)},
        {"base_T_camera": Pose.of(np.eye(3), np.array([1e308, 0, 0]))},
    ],
    ids=["table", "camera"],
)
def test_a_table_or_camera_out_of_this_world_is_refused(far: dict[str, Any]) -> None:
    with pytest.raises(InvalidInput, match="1e\\+308"):
        dataclasses.replace(SCENE, **far)
