"""Household objects made of MuJoCo's primitives, standing on z = 0: MJCF geoms, sizes in m."""

from __future__ import annotations

import math
from itertools import pairwise

_STAVES = 24


def _geom(kind: str, size: str, pos: str, more: str = "") -> str:
    return f'<geom class="object" type="{kind}" size="{size}" pos="{pos}" {more}/>'


def _bar(start: str, end: str, radius: float) -> str:
    return f'<geom class="object" type="capsule" size="{radius}" fromto="{start} {end}"/>'


def _ring(radius: float, low: float, high: float, wall: float) -> str:
    """A hollow upright cylinder of flat staves; `radius` is the outer one."""
    half, middle = math.pi * radius / _STAVES * 1.02, radius - wall / 2
    return "".join(
        _geom(
            "box",
            f"{wall / 2} {half} {(high - low) / 2}",
            f"{middle * math.cos(a)} {middle * math.sin(a)} {(low + high) / 2}",
            f'euler="0 0 {math.degrees(a)}"',
        )
        for a in (2 * math.pi * k / _STAVES for k in range(_STAVES))
    )


def _mug() -> str:
    handle = [(0.038, 0.078), (0.062, 0.072), (0.066, 0.045), (0.058, 0.024), (0.038, 0.020)]
    bars = [_bar(f"{x} 0 {z}", f"{a} 0 {b}", 0.005) for (x, z), (a, b) in pairwise(handle)]
    return _ring(0.041, 0.0, 0.095, 0.004) + _geom("cylinder", "0.039 0.003", "0 0 0.003") + "".join(bars)


def _hammer() -> str:
    """Lying on its side."""
    return (
        _bar("-0.13 0 0.014", "0.10 0 0.014", 0.012)
        + _geom("box", "0.014 0.050 0.014", "0.11 0 0.014")
        + _geom("cylinder", "0.016 0.012", "0.11 0.055 0.016", 'euler="90 0 0"')
    )


def _spray_bottle() -> str:
    return (
        _geom("ellipsoid", "0.042 0.028 0.075", "0 0 0.062")
        + _geom("box", "0.036 0.024 0.006", "0 0 0.006")
        + _geom("cylinder", "0.013 0.02", "0 0 0.145")
        + _geom("box", "0.038 0.012 0.012", "0.014 0 0.175")
        + _bar("0.035 0 0.160", "0.045 0 0.125", 0.005)
    )


def _pan() -> str:
    return (
        _ring(0.085, 0.0, 0.040, 0.005)
        + _geom("cylinder", "0.083 0.003", "0 0 0.003")
        + _geom("box", "0.075 0.011 0.007", "0.158 0 0.033")
    )


def _stapler() -> str:
    return (
        _geom("box", "0.070 0.018 0.005", "0 0 0.005")
        + _geom("box", "0.068 0.014 0.009", "0.002 0 0.035", 'euler="0 -9 0"')
        + _geom("cylinder", "0.012 0.018", "-0.062 0 0.020", 'euler="90 0 0"')
    )


OBJECTS = {"mug": _mug, "hammer": _hammer, "spray bottle": _spray_bottle, "pan": _pan, "stapler": _stapler}
"""By name: what makes the object's geoms."""
