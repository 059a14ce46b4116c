"""What a module reads over a step: a flat table and, beyond a straight edge, a flat top parallel to it.

The step's frame has z along the table's normal, y along the edge, and the top at x < 0; the edge is at x = 0 and the
table at z = 0. The module sees a cone of rays. Each answers with response * cos(incidence) / r^2, a Lambertian target;
modules that trigger on the front of the pulse count near parts for more, by exp(-decay * r). Of the two surfaces each
has its mean range, weighted by its light^sharpness: 1 is the mean of everything, and a large one is the stronger of two
peaks. The reading is scaled so that a perpendicular wall at `CALIBRATED_AT` reads its distance.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import numpy as np

from pretouch.geometry import Array

CALIBRATED_AT = 0.05
"""m, of the plate's distances; the scale hardly depends on it."""
_RINGS = 3
_REACH = {2: 1.7, 12: 1.15}


class Profile(Enum):
    """How the response falls off the axis, to half at the half angle: exp(-ln 2 (angle / half angle)^value)."""

    ROUND = 2
    FLAT = 12


class Response(NamedTuple):
    """Half angle, rad; decay, 1/m, 0 where near and far parts count alike; sharpness; how the response falls off."""

    half_angle: float
    decay: float
    sharpness: float
    profile: Profile


class Step(NamedTuple):
    """A step: frame in base, rotation (3, 3) and translation (3,), m; height, m; the top's light by the table's."""

    rotation: Array
    translation: Array
    height: float
    brightness: float


def make_rays(response: Response) -> tuple[Array, Array]:
    """Unit rays (k, 3) about z, an equal share of the view each, and the response (k,) along each."""
    reach = _REACH[response.profile.value] * response.half_angle
    polar, turn = [np.zeros(1)], [np.zeros(1)]
    for ring in range(1, _RINGS + 1):
        polar.append(np.full(6 * ring, reach * ring / (_RINGS + 0.5)))
        turn.append(np.pi * (np.arange(6 * ring) + 0.25 * (ring % 2)) / (3 * ring))
    t, p = np.concatenate(polar), np.concatenate(turn)
    rays = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=1)
    return rays, np.exp(-np.log(2.0) * (t / max(response.half_angle, 1e-6)) ** response.profile.value)


def predict_ranges(base_T_module: Array, step: Step, response: Response) -> Array:
    """(n,), m, from module poses (n, 4, 4), beams along their z.

    A ray near the edge meets the top with a share that falls smoothly over the width of a ray, so that the ranges are a
    smooth function of everything.
    """
    rays, strength = make_rays(response)
    origins = (base_T_module[:, :3, 3] - step.translation) @ step.rotation
    ways = step.rotation.T @ base_T_module[:, :3, :3] @ rays.T
    x, z = origins[:, 0, None], origins[:, 2, None]
    across, down = ways[:, 0], np.minimum(ways[:, 2], -1e-3)
    table, top = np.maximum(-z / down, 1e-4), np.maximum((step.height - z) / down, 1e-4)
    spacing = _REACH[response.profile.value] * response.half_angle / (_RINGS + 0.5)
    width = np.maximum(top * spacing / 4, 2e-4)
    share = 1 / (1 + np.exp(np.clip((x + top * across) / width, -40.0, 40.0)))
    faced = 1 / (1 + np.exp(np.clip((x + table * across) / width, -40.0, 40.0)))
    low = np.clip(-x / np.minimum(across, -1e-3), top, table)
    low = faced * low + (1 - faced) * table
    incidence = faced * np.abs(across) + (1 - faced) * -down
    lights = strength * share * -down * step.brightness / top**2, strength * (1 - share) * incidence / low**2
    nearest = np.minimum(top, low).min(axis=1, keepdims=True)
    weights = [
        light * np.exp(-response.decay * (path - nearest)) for light, path in zip(lights, (top, low), strict=True)
    ]
    totals = [weight.sum(axis=1) + 1e-30 for weight in weights]
    means = [(w * path).sum(axis=1) / total for w, path, total in zip(weights, (top, low), totals, strict=True)]
    odds = np.exp(np.clip(response.sharpness * np.log(totals[0] / totals[1]), -60.0, 60.0))
    mean = (odds * means[0] + means[1]) / (1 + odds)
    return np.asarray(mean * (CALIBRATED_AT / _read_wall(rays, strength, response.decay)))


def _read_wall(rays: Array, strength: Array, decay: float) -> float:
    path = CALIBRATED_AT / rays[:, 2]
    weight = strength * rays[:, 2] / path**2 * np.exp(-decay * (path - CALIBRATED_AT))
    return float(weight @ path / weight.sum())
