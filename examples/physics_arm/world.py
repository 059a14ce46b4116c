"""The world: an arm with the Franka Panda's published link lengths and joint limits, a table, and an object on it.

The base frame is the world's; the table's top is z = 0. The site `tip` is the fingertip sensor, z along its beam.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from examples.physics_arm.objects import OBJECTS

ASIDE = np.array([-1.8, 0.2, 0.0, -2.2, 0.0, 2.4, 0.785])
"""rad: the arm out of the camera's view."""

_LINKS = (  # pos of the joint in the link before, turn about x in degrees, limits in degrees, torque in N m, geom
    ("0 0 0.333", 0, "-166 166", 87, "0 0 -0.14  0 0 0", 0.06),
    ("0 0 0", -90, "-101 101", 87, "0 0 -0.05  0 0 0.05", 0.06),
    ("0 -0.316 0", 90, "-166 166", 87, "0 0 -0.20  0 0 0", 0.055),
    ("0.0825 0 0", 90, "-176 -4", 87, "0 0 -0.04  0 0 0.04", 0.055),
    ("-0.0825 0.384 0", -90, "-166 166", 12, "0 0.03 -0.26  0 0 -0.02", 0.05),
    ("0 0 0", 90, "-1 215", 12, "0 0 -0.03  0.03 0 0.03", 0.05),
    ("0.088 0 0", 90, "-166 166", 12, "0 0 0.03  0 0 0.08", 0.045),
)
_FINGER = """
<body name="finger" pos="0 0 0.107" gravcomp="1">
  <geom class="arm" type="capsule" size="0.012" fromto="0 0 0.01 0 0 0.09"/>
  <geom class="arm" type="cylinder" size="0.007 0.025" pos="0 0 0.115"/>
  <site name="tip" pos="0 0 0.14"/>
</body>"""
_WORLD = """
<mujoco>
  <compiler angle="degree" autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <default>
    <default class="arm"><geom group="2" density="600"/></default>
    <default class="object"><geom group="1"/></default>
    <joint armature="0.1" damping="1"/>
  </default>
  <worldbody>
    <geom name="table" type="box" size="0.7 0.8 0.02" pos="0.45 0 -0.02"/>
    <body name="object" pos="{x} {y} 0" euler="0 0 {yaw}">{object}</body>
    {arm}
  </worldbody>
  <contact><exclude body1="link5" body2="link7"/></contact>
  <actuator>{motors}</actuator>
</mujoco>"""


def get_tip_pose(state: mujoco.MjData) -> NDArray[np.float64]:
    """(4, 4): where the sensor is in `state`, in base."""
    site = state.site("tip")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = site.xmat.reshape(3, 3), site.xpos
    return pose


@dataclass(frozen=True, eq=False)
class World:
    """The model and its state; the arm starts at ASIDE."""

    model: mujoco.MjModel
    data: mujoco.MjData

    @staticmethod
    def of(name: str, random: np.random.Generator) -> World:
        """The object of this name somewhere before the arm, turned at random."""
        place = {"x": random.uniform(0.42, 0.62), "y": random.uniform(-0.15, 0.15), "yaw": random.uniform(-180, 180)}
        arm, motors = _FINGER, ""
        for k, (pos, turn, limits, torque, ends, radius) in reversed(list(enumerate(_LINKS, start=1))):
            arm = (
                f'<body name="link{k}" pos="{pos}" euler="{turn} 0 0" gravcomp="1">'
                f'<joint name="joint{k}" axis="0 0 1" range="{limits}"/>'
                f'<geom class="arm" type="capsule" size="{radius}" fromto="{ends}"/>{arm}</body>'
            )
            motors = (
                f'<position joint="joint{k}" kp="{40 * torque}" kv="{torque}" forcerange="-{torque} {torque}"/>{motors}'
            )
        text = _WORLD.format(object=OBJECTS[name](), arm=arm, motors=motors, **place)
        model = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(model)
        data.qpos[:] = data.ctrl[:] = ASIDE
        mujoco.mj_forward(model, data)
        return World(model, data)

    def base_T_tip(self) -> NDArray[np.float64]:
        """(4, 4): where the sensor is now."""
        return get_tip_pose(self.data)

    def is_touching(self) -> bool:
        """Whether the arm touches the object, the table or itself."""
        return bool(self.data.ncon > 0)

    def object_geoms(self) -> NDArray[np.intp]:
        """The ids of the object's geoms."""
        return np.flatnonzero(self.model.geom_bodyid == self.model.body("object").id)
