"""How low the fingertip is planned in an evaluation."""

from __future__ import annotations

from enum import StrEnum

from pretouch_orchestrator.planning.tip_floor import SAFE, Margins


class TipHeight(StrEnum):
    """From what the tip's height is planned.

    `SAFE`: from the worst that the estimate leaves possible, as in every session. `LOW`: from what is expected, one
    standard deviation to each side and never below 10 mm, as a robot could whose own reflex lifts the tip.
    """

    SAFE = "safe"
    LOW = "low"

    @property
    def margins(self) -> Margins:
        return SAFE if self is TipHeight.SAFE else Margins(sigmas=1.0, safe_sigmas=1.0, closest=0.010)
