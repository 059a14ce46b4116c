"""A small picture of what the camera saw of the object and the table."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass

import numpy as np
from PIL import Image

from pretouch.scene import TABLE_BAND, Scene

_MAX_SIDE = 420
"""px, of the picture: a PNG of noise of this size takes less than 200 kB."""
_MARGIN = 0.6
"""Around the object, as a share of its longer side."""
_NEAR, _MIDDLE, _FAR = (253.0, 231.0, 90.0), (70.0, 150.0, 160.0), (30.0, 45.0, 110.0)
"""The object from near to far; lightness alone tells the depth too."""
_PALE, _DARK, _DARKENING = 205.0, 120.0, 50.0
"""The table's and other things' grey where they are near, and how much darker it is where they are far."""
_NO_DEPTH, _OBJECT, _TABLE, _OTHER = range(4)
_LEVELS = 64
"""Colours of each."""


@dataclass(frozen=True)
class Picture:
    """A PNG of the scene.

    Attributes:
        data: the `data:` URL.
        window: (u0, v0, w, h): the part of the scene, in its pixels.
        near, far: m, depths of the object's lightest and darkest pixels.
    """

    data: str
    window: tuple[int, int, int, int]
    near: float
    far: float


def draw_scene(scene: Scene) -> Picture:
    """The object in colours by depth, the table and other things in grey by depth, the table the paler; black: no
    depth.
    """
    height, width = scene.depth.metres.shape
    u0, v0, u1, v1 = scene.bounds()
    margin = int(_MARGIN * max(u1 - u0, v1 - v0))
    u0, v0, u1, v1 = max(0, u0 - margin), max(0, v0 - margin), min(width, u1 + margin), min(height, v1 + margin)
    step = -(-max(u1 - u0, v1 - v0) // _MAX_SIDE)
    small = np.s_[v0:v1:step, u0:u1:step]
    depth, mask = np.asarray(scene.depth.metres[small], dtype=np.float64), scene.mask[small]
    near, far = (float(x) for x in np.quantile(scene.depth.metres[scene.mask], (0.02, 0.98)))
    share = np.clip((depth - near) / max(far - near, 1e-6), 0, 1)
    table = np.abs(scene.organised[small] @ scene.table.normal - scene.table.offset) < TABLE_BAND
    ramp = np.select([depth <= 0, mask, table], [_NO_DEPTH, _OBJECT, _TABLE], _OTHER)
    colours = (_LEVELS * ramp + np.round(share * (_LEVELS - 1))).astype(np.uint8)
    image = Image.fromarray(colours, "P")
    image.putpalette(_make_palette())
    file = io.BytesIO()
    image.save(file, "PNG", optimize=True)
    data = base64.b64encode(file.getvalue()).decode("ascii")
    return Picture(f"data:image/png;base64,{data}", (u0, v0, u1 - u0, v1 - v0), near, far)


def _make_palette() -> bytes:
    """The colours of the four ramps, each from near to far."""
    share = np.linspace(0, 1, _LEVELS)
    stops = np.array([_NEAR, _MIDDLE, _FAR])
    ramps = np.zeros((4, _LEVELS, 3))
    ramps[_OBJECT] = np.stack([np.interp(share, (0, 0.5, 1), stops[:, k]) for k in range(3)], axis=-1)
    ramps[_TABLE], ramps[_OTHER] = (_PALE - _DARKENING * share)[:, None], (_DARK - _DARKENING * share)[:, None]
    return ramps.astype(np.uint8).tobytes()
