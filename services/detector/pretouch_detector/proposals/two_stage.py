"""Regions by the two-stage network, which proposes rectangles by itself instead of ranking drawn ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pretouch.estimate import Prior, from_prior
from pretouch.geometry import Array
from pretouch.rectangle import RotatedRectangle
from pretouch.scene import Scene
from pretouch_detector.model.encoding import encode
from pretouch_detector.model.rcnn_network import TwoStageNetwork
from pretouch_detector.proposals.random import allowed
from pretouch_detector.proposals.region import ProposedRegion


def regions(network: TwoStageNetwork, scene: Scene, count: int) -> list[ProposedRegion]:
    """Up to `count` regions that differ; confidence = share of the prior's error that the scan would remove."""

    def may(rectangles: Array) -> NDArray[np.bool_]:
        return allowed(rectangles, scene)

    rectangles, errors = network.proposed(encode(scene), may, count)
    confidence = np.clip(1.0 - errors / from_prior(Prior(), scene.cloud).expected_error, 0.0, 1.0)
    return [
        ProposedRegion(RotatedRectangle(*rectangle), float(share))
        for rectangle, share in zip(rectangles, confidence, strict=True)
    ]
