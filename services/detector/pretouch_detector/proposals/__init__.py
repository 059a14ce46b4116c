"""Proposers of regions worth scanning, behind one interface: `propose`.

A proposer is a function `(scene, sensor, count, rng) -> list[ProposedRegion]`, the best region first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pretouch.errors import InvalidInput, Unavailable
from pretouch.scene import Scene
from pretouch.session import Proposer
from pretouch.tof import Sensor
from pretouch_detector.proposals import deep, narf, random, stability
from pretouch_detector.proposals.region import ProposedRegion

MAX_REGIONS = 200
_PROPOSERS: dict[Proposer, Callable[[Scene, Sensor, int, np.random.Generator], list[ProposedRegion]]] = {
    Proposer.DEEP: deep.propose,
    Proposer.STABILITY: stability.propose,
    Proposer.RANDOM: random.propose,
    Proposer.NARF: narf.propose,
}
"""The best first."""


@dataclass(frozen=True)
class Proposals:
    """The regions, the best first, and the proposer that made them."""

    proposer: Proposer
    regions: list[ProposedRegion]


def readiness() -> list[tuple[Proposer, str]]:
    """Each proposer, the usable ones first, with the reason why it is not ready; empty when it is."""
    return sorted(((proposer, _obstacle(proposer)) for proposer in _PROPOSERS), key=lambda pair: bool(pair[1]))


def propose(scene: Scene, proposer: Proposer | None, sensor: Sensor, count: int, seed: int) -> Proposals:
    """Up to `count` regions by `proposer`; None takes the best that is ready. The same arguments give the same answer.

    Raises:
        InvalidInput: count out of range.
        Unavailable: the proposer is not ready.
    """
    if not 1 <= count <= MAX_REGIONS:
        raise InvalidInput(f"{count} regions were asked for.", f"Ask for 1 to {MAX_REGIONS}.")
    chosen = proposer or readiness()[0][0]
    if obstacle := _obstacle(chosen):
        names = ", ".join(name for name, reason in readiness() if not reason)
        raise Unavailable(f"The proposer {chosen} is not ready: {obstacle}", f"Choose one of {names}.")
    return Proposals(chosen, _PROPOSERS[chosen](scene, sensor, count, np.random.default_rng(seed)))


def _obstacle(proposer: Proposer) -> str:
    return deep.not_ready() if proposer is Proposer.DEEP else ""
