"""A depth frame of a box and a can, rendered, in the format of the real ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from pretouch_simulation.depth_cameras.kinect import Kinect
from pretouch_simulation.mesh import Mesh
from pretouch_simulation.objects import box, can
from pretouch_simulation.protocol import PLACE, TABLE, look_at
from pretouch_simulation.world import Body, World

from pretouch.camera import Camera
from pretouch.geometry import Pose

CAMERA = Camera(525, 525, 319.5, 239.5)
SHAPE = (480, 640)


def write_mesh(path: Path, mesh: Mesh) -> None:
    """Writes an OBJ file."""
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + [f"f {a} {b} {c}" for a, b, c in mesh.faces + 1]
    path.write_text("\n".join(lines) + "\n")


def write_frame(folder: Path) -> Path:
    """Writes the frame's files into `folder`; the path of its .json."""
    base_T_camera = look_at(PLACE, 0.7, 0.9)
    meshes = {"box": box(0.08, 0.06, 0.05), "can": can(0.03, 0.06)}
    places = {"box": [0.0, 0.0, 0.0], "can": [0.0, 0.13, 0.0]}
    bodies = [Body(meshes[name], Pose.of(np.eye(3), PLACE + np.array(places[name]))) for name in meshes]
    image = Kinect().render(World(bodies, TABLE), CAMERA, base_T_camera, np.random.default_rng(0), SHAPE)
    objects: list[dict[str, Any]] = []
    for k, (name, mesh) in enumerate(meshes.items()):
        write_mesh(folder / f"{name}.obj", mesh)
        camera_T_object = base_T_camera.inverse() @ bodies[k].base_T_mesh
        objects.append(
            {"name": name, "label": k + 3, "mesh": f"{name}.obj", "T_cam_obj": camera_T_object.matrix.tolist()}
        )
    Image.fromarray(np.round(image.depth.metres * 10000).astype(np.uint16)).save(folder / "depth.png")
    Image.fromarray(np.where(image.bodies >= 0, image.bodies + 3, 0).astype(np.uint8)).save(folder / "label.png")
    description = {
        "width": SHAPE[1],
        "height": SHAPE[0],
        **{"fx": CAMERA.fx, "fy": CAMERA.fy, "cx": CAMERA.cx, "cy": CAMERA.cy},
        "depth_unit_m": 0.0001,
        "files": {"depth": "depth.png", "label": "label.png"},
        "objects": objects,
    }
    path = folder / "frame.json"
    path.write_text(json.dumps(description))
    return path
