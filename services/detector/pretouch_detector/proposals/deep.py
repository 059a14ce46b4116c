"""Proposer `deep`: random candidates ranked by the pose error that a trained network predicts for each.

The network encodes the scene once, then evaluates each perimeter and corrects the error that proposer `stability`
computes. It skips candidates that `stability` ranks low: it seldom ranks them higher, and each one takes time.
"""

from __future__ import annotations

import numpy as np

from pretouch.errors import Unavailable
from pretouch.estimate import from_prior
from pretouch.geometry import Array
from pretouch.prior import Prior
from pretouch.rectangle import ProposedRegion, RotatedRectangle
from pretouch.scene import Scene
from pretouch.tof import Sensor
from pretouch_detector.model.encoding import encode
from pretouch_detector.model.weights import FOLDER, THREADS, Network, Weights
from pretouch_detector.proposals.information import predict_errors_after_scans
from pretouch_detector.proposals.random import draw_rectangles
from pretouch_detector.suppression import suppress_overlapping

WEIGHTS = Weights(FOLDER)
_MARGIN = 0.13
"""m around the object that the network sees: about the margin of a session's view, on which it was trained."""
_CANDIDATES, _EVALUATED = 480, 240
"""How many candidates are drawn, and how many of the best by `stability` the network evaluates, at least."""


def propose(scene: Scene, sensor: Sensor, count: int, rng: np.random.Generator) -> list[ProposedRegion]:
    """Up to `count` regions that differ; confidence = share of the prior's error that the scan would remove.

    Raises:
        Unavailable: the network cannot be read.
    """
    return propose_with(WEIGHTS.get_network(), scene, sensor, count, rng)


def explain_unready() -> str:
    """Why the proposer cannot be used; empty when it can."""
    try:
        WEIGHTS.get_network()
    except Unavailable as error:
        return error.detail
    return ""


def warm_up(threads: int = THREADS) -> None:
    """Loads the network, if possible, for inference with `threads` threads."""
    try:
        WEIGHTS.get_network(threads)
    except Unavailable:
        return


def propose_with(
    network: Network, scene: Scene, sensor: Sensor, count: int, rng: np.random.Generator
) -> list[ProposedRegion]:
    """As `propose`, with the given network."""
    scene, origin = scene.cropped(_MARGIN)
    rectangles = draw_rectangles(scene, max(_CANDIDATES, count), rng)
    analytic, _ = predict_errors_after_scans(scene, sensor, rectangles)
    chosen = np.argsort(analytic, kind="stable")[: max(_EVALUATED, count)]
    rectangles = rectangles[chosen]
    errors = network.predict_errors(encode(scene), rectangles, analytic[chosen])
    order = np.argsort(errors, kind="stable")
    kept = order[suppress_overlapping(rectangles[order], count)]
    confidence = np.clip(1.0 - errors / from_prior(Prior(), scene.cloud).expected_error, 0.0, 1.0)
    rectangles[:, :2] += origin
    return [ProposedRegion(RotatedRectangle(*rectangles[k]), float(confidence[k])) for k in kept]


def predict_errors(network: Network, scene: Scene, sensor: Sensor, rectangles: Array) -> Array:
    """(n,), m: the error that a scan along each perimeter would leave; rectangles (n, 5) in the scene's pixels."""
    analytic, _ = predict_errors_after_scans(scene, sensor, rectangles)
    return network.predict_errors(encode(scene), rectangles, analytic)
