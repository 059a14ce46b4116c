"""An inexpensive view: an exact depth image of one box on a table, and its request."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

WIDTH, HEIGHT, FOCAL = 320, 240, 262.5
DEPTH_SCALE = 0.0001
BOX_LOW, BOX_HIGH = np.array([0.41, -0.03, 0.0]), np.array([0.49, 0.03, 0.05])
"""Opposite corners of the box, m, in base; the table is z = 0."""
_TARGET = np.array([0.45, 0.0, 0.02])
_DISTANCE = 0.7


def base_T_camera() -> NDArray[np.float64]:
    """4x4: the camera looks down at the box by 45 degrees."""
    forward = np.array([1.0, 0.0, -1.0]) / np.sqrt(2)
    right = np.array([0.0, -1.0, 0.0])
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    matrix[:3, 3] = _TARGET - _DISTANCE * forward
    return matrix


def depth_and_mask() -> tuple[NDArray[np.uint16], NDArray[np.uint8]]:
    """The depth image (HEIGHT, WIDTH), in DEPTH_SCALE metres, and the mask of the box, 255 on it."""
    pose = base_T_camera()
    v, u = np.indices((HEIGHT, WIDTH))
    rays = np.stack([(u - (WIDTH - 1) / 2) / FOCAL, (v - (HEIGHT - 1) / 2) / FOCAL, np.ones_like(u)], axis=-1)
    directions, start = rays @ pose[:3, :3].T, pose[:3, 3]
    with np.errstate(divide="ignore"):
        first, second = (BOX_LOW - start) / directions, (BOX_HIGH - start) / directions
    enter = np.minimum(first, second).max(axis=-1)
    leave = np.maximum(first, second).min(axis=-1)
    table = -start[2] / directions[..., 2]
    on_box = (enter < leave) & (enter > 0)
    depth = np.where(on_box, enter, np.where(table > 0, table, 0.0))
    return np.round(depth / DEPTH_SCALE).clip(0, 65535).astype(np.uint16), np.where(on_box, 255, 0).astype(np.uint8)


def png(image: NDArray[Any]) -> bytes:
    """A greyscale PNG of a uint8 or uint16 image (h, w)."""
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, format="PNG")
    return stream.getvalue()


def request(**changes: Any) -> dict[str, Any]:
    """The JSON of part `request`; `changes` replace members."""
    return {
        "camera": {
            "fx": FOCAL,
            "fy": FOCAL,
            "cx": (WIDTH - 1) / 2,
            "cy": (HEIGHT - 1) / 2,
            "depth_scale": DEPTH_SCALE,
        },
        "base_T_camera": {
            "translation": base_T_camera()[:3, 3].tolist(),
            "rotation": [-0.6532814824381883, 0.6532814824381883, -0.27059805007309845, 0.27059805007309845],
        },
        **changes,
    }


def multipart(**changes: Any) -> dict[str, tuple[str, bytes, str]]:
    """`files` for httpx: a session on the box, with its mask."""
    depth, mask = depth_and_mask()
    return {
        "request": ("request.json", json.dumps(request(**changes)).encode(), "application/json"),
        "depth": ("depth.png", png(depth), "image/png"),
        "mask": ("mask.png", png(mask), "image/png"),
    }


def samples(plan: dict[str, Any], distance: float = 0.03) -> dict[str, Any]:
    """The body of a scan along `plan`, which is a session's `next_scan`: one sample a waypoint, all at one range."""
    return {"samples": [waypoint | {"range": distance} for waypoint in plan["waypoints"]]}
