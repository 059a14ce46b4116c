"""Selects the beams of a scan that give information about the object."""

from __future__ import annotations

import numpy as np

from pretouch.prior import Prior
from pretouch.scene import Scene
from pretouch.tof import Scan, Sensor

_SIGMAS = 3.0
_MARGIN = 0.06
"""m beyond where the object may be: the table beside it is kept, since its height constrains the object's."""


def select_beams(scene: Scene, scan: Scan, prior: Prior, sensor: Sensor) -> Scan:
    """The distinct beams of the scan that end, or for a miss pass, where the object may be or just beside it.

    Beams that end farther away hit something else. They are left out even if some correction would make them fit the
    table or the object.
    """
    hit = scan.returned
    relative = scan.origins - scene.centroid
    along = np.where(hit, scan.ranges, np.clip(-(relative * scan.directions).sum(axis=1), 0.0, sensor.range_max))
    distance = np.linalg.norm(relative + along[:, None] * scan.directions, axis=1)
    extent = float(np.linalg.norm(scene.cloud - scene.centroid, axis=1).max())
    reach = extent + _SIGMAS * np.sqrt(3.0) * (prior.translation_std + prior.rotation_std * extent) + _MARGIN
    rows = np.column_stack([scan.origins, scan.directions, np.where(hit, scan.ranges, -1.0)])
    distinct = np.zeros(len(scan), dtype=bool)
    distinct[np.unique(rows, axis=0, return_index=True)[1]] = True
    kept = distinct & (distance <= reach)
    if kept.all():
        return scan
    return Scan(scan.origins[kept], scan.directions[kept], scan.ranges[kept])
