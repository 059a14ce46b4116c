"""Proposer `stability`: random candidates ranked by the pose error that a scan of their perimeter would leave."""

from __future__ import annotations

import numpy as np

from pretouch.rectangle import ProposedRegion, RotatedRectangle
from pretouch.scene import Scene
from pretouch.tof import Sensor
from pretouch_detector.proposals.information import predict_errors_after_scans
from pretouch_detector.proposals.random import draw_rectangles
from pretouch_detector.suppression import suppress_overlapping

_CANDIDATES = 200


def propose(scene: Scene, sensor: Sensor, count: int, rng: np.random.Generator) -> list[ProposedRegion]:
    """Up to `count` regions that differ; confidence = share of the prior's error that the scan would remove."""
    rectangles = draw_rectangles(scene, max(_CANDIDATES, count), rng)
    remaining, before = predict_errors_after_scans(scene, sensor, rectangles)
    order = np.argsort(remaining, kind="stable")
    kept = order[suppress_overlapping(rectangles[order], count)]
    return [
        ProposedRegion(RotatedRectangle(*rectangles[k]), float(np.clip(1.0 - remaining[k] / before, 0.0, 1.0)))
        for k in kept
    ]
