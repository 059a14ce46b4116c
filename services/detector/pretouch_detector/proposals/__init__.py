"""Proposers of regions worth scanning, behind one interface: `propose`.

`pretouch.session.Proposer` lists them; each is the module of its name in this package, with a function
`propose(scene, sensor, count, rng) -> list[ProposedRegion]`, the best region first. A module that needs something that
may be missing also has `explain_unready() -> str`, empty when the proposer can be used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from pretouch.camera import Camera, DepthImage
from pretouch.errors import InvalidInput, Unavailable
from pretouch.geometry import Plane, Pose
from pretouch.rectangle import ProposedRegion
from pretouch.scene import Scene
from pretouch.session import Proposer
from pretouch.tof import Sensor

MAX_REGIONS = 200


@dataclass(frozen=True)
class Proposals:
    """The regions, the best first, and the proposer that made them."""

    proposer: Proposer
    regions: list[ProposedRegion]


def list_readiness() -> list[tuple[Proposer, str]]:
    """Each proposer, the usable ones first, with the reason why it is not ready; empty when it is."""
    return sorted(((proposer, _explain_unready(proposer)) for proposer in Proposer), key=lambda pair: bool(pair[1]))


def propose(scene: Scene, proposer: Proposer | None, sensor: Sensor, count: int, seed: int) -> Proposals:
    """Up to `count` regions by `proposer`; None takes the best that is ready. The result is deterministic.

    Raises:
        InvalidInput: count out of range.
        Unavailable: the proposer is not ready.
    """
    if not 1 <= count <= MAX_REGIONS:
        raise InvalidInput(f"{count} regions were requested.", f"Ask for 1 to {MAX_REGIONS}.")
    chosen = proposer or list_readiness()[0][0]
    if obstacle := _explain_unready(chosen):
        names = ", ".join(name for name, reason in list_readiness() if not reason)
        raise Unavailable(
            f"The proposer {chosen} is not ready: {obstacle}", f"Choose one of {names}.", retry_after=math.inf
        )
    regions: list[ProposedRegion] = _import_module(chosen).propose(scene, sensor, count, np.random.default_rng(seed))
    return Proposals(chosen, regions)


def _explain_unready(proposer: Proposer) -> str:
    module = _import_module(proposer)
    reason: str = module.explain_unready() if hasattr(module, "explain_unready") else ""
    return reason


def warm_up() -> None:
    """Compiles or loads everything that requests to the ready proposers need."""
    depth = np.ones((24, 24), np.float32)
    mask = np.zeros(depth.shape, np.bool_)
    mask[8:16, 8:16] = True
    camera, table = Camera(500.0, 500.0, 11.5, 11.5), Plane(np.array([0.0, 0.0, 1.0]), 0.0)
    scene = Scene(DepthImage(depth), camera, Pose.identity(), mask, table)
    for proposer, reason in list_readiness():
        if not reason:
            propose(scene, proposer, Sensor(), 1, 0)


def _import_module(proposer: Proposer) -> Any:
    """Imported on first use, since numba takes a second to import."""
    return import_module(f"{__name__}.{proposer.value}")
