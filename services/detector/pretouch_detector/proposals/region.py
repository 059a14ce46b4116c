"""What a proposer answers."""

from __future__ import annotations

from dataclasses import dataclass

from pretouch.rectangle import RotatedRectangle


@dataclass(frozen=True)
class ProposedRegion:
    """A rectangle in the scene's pixels and the proposer's score in [0, 1], comparable within one answer only."""

    rectangle: RotatedRectangle
    confidence: float
