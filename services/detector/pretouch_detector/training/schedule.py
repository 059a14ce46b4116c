"""How long and how fast the network is trained; without torch, so that the command line can show it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Schedule:
    """How long and how fast.

    Attributes:
        batch: views a step and process.
        rectangles: of each view.
        rate: the highest learning rate; it rises over the first twentieth of the steps, then falls as a cosine.
        average: share of the running average that a step keeps.
    """

    epochs: int = 40
    batch: int = 16
    rectangles: int = 40
    rate: float = 2e-3
    decay: float = 0.02
    average: float = 0.995
    seed: int = 0
