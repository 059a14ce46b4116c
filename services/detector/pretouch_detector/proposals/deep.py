"""Proposer `deep`: random candidates ranked by the pose error that a trained network foretells for each.

The network looks at the scene once and then at the perimeter of any rectangle. The best candidates are varied and asked
about again: a few hundred draws over five dimensions only come near the best.
"""

from __future__ import annotations

import numpy as np

from pretouch.errors import Unavailable
from pretouch.estimate import Prior, from_prior
from pretouch.geometry import Array
from pretouch.rectangle import RotatedRectangle
from pretouch.scene import Scene
from pretouch.tof import Sensor
from pretouch_detector.model.encoding import encode
from pretouch_detector.model.weights import FOLDER, THREADS, Network, Weights
from pretouch_detector.proposals.random import allowed, drawn
from pretouch_detector.proposals.region import ProposedRegion
from pretouch_detector.proposals.spread import spread

WEIGHTS = Weights(FOLDER, "scorer")
_MARGIN = 0.13
"""m around the object that the network may see: a session's view has about as much, and the network learned by it."""
_CANDIDATES = 256
_ROUNDS = 1
_PARENTS, _CHILDREN = 24, 4
"""In each round, how many of the best are varied, and how many variants each has."""
_SHIFT, _STRETCH, _TURN = 0.08, 0.12, 0.15
"""Standard deviations of a variant: in the geometric mean of the sides, of their logarithms, and rad."""


def propose(scene: Scene, sensor: Sensor, count: int, rng: np.random.Generator) -> list[ProposedRegion]:
    """Up to `count` regions that differ; confidence = share of the prior's error that the scan would remove.

    Raises:
        Unavailable: the network cannot be read.
    """
    return regions(WEIGHTS.network(), scene, count, rng)


def not_ready() -> str:
    """Why the proposer cannot be used; empty when it can."""
    try:
        WEIGHTS.network()
    except Unavailable as error:
        return error.detail
    return ""


def warm_up(threads: int = THREADS) -> None:
    """Reads the network, if it can be, for questions that occupy so many threads each."""
    try:
        WEIGHTS.network(threads)
    except Unavailable:
        return


def regions(network: Network, scene: Scene, count: int, rng: np.random.Generator) -> list[ProposedRegion]:
    """As `propose`, by any network."""
    scene, origin = scene.cropped(_MARGIN)
    encoding = encode(scene)
    rectangles = drawn(scene, max(_CANDIDATES, count), rng)
    errors = network.errors(encoding, rectangles)
    for _ in range(_ROUNDS):
        best = np.argsort(errors, kind="stable")[:_PARENTS]
        variants = _varied(np.repeat(rectangles[best], _CHILDREN, axis=0), rng)
        variants = variants[allowed(variants, scene)]
        if len(variants):
            rectangles = np.concatenate([rectangles, variants])
            errors = np.concatenate([errors, network.errors(encoding, variants)])
    order = np.argsort(errors, kind="stable")
    kept = order[spread(rectangles[order], count)]
    confidence = np.clip(1.0 - errors / from_prior(Prior(), scene.cloud).expected_error, 0.0, 1.0)
    rectangles[:, :2] += origin
    return [ProposedRegion(RotatedRectangle(*rectangles[k]), float(confidence[k])) for k in kept]


def _varied(rectangles: Array, rng: np.random.Generator) -> Array:
    """Each rectangle (n, 5) moved, stretched and turned a little."""
    n = len(rectangles)
    side = np.sqrt(rectangles[:, 2:3] * rectangles[:, 3:4])
    centre = rectangles[:, :2] + _SHIFT * side * rng.standard_normal((n, 2))
    sides = rectangles[:, 2:4] * np.exp(_STRETCH * rng.standard_normal((n, 2)))
    theta = rectangles[:, 4:] + _TURN * rng.standard_normal((n, 1))
    return np.concatenate([centre, sides, theta], axis=1)
