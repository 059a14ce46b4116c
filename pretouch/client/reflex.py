"""A robot's own reflex for guarded scans: it lifts the fingertip while something is too near."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from pretouch.geometry import Array
from pretouch.tof import STATUS_OK
from pretouch.trajectory import Trajectory

RANGE_UNDERFLOW = 14
"""The VL6180X's status code of a target that is too near to be measured, which most formats of the gateway use."""


DESCENT = 0.10
"""m along the beam to a path's first waypoint, over which the ranges count already."""
_DESCENT_SPEED = 0.10
"""m/s; the tip must be able to rise faster."""


def add_descent(path: Trajectory) -> Trajectory:
    """`path` after a descent of `DESCENT` m along the beam to its first pose; its own times stay, the descent's are
    before them."""
    above = path.base_T_tip[0].copy()
    above[:3, 3] -= DESCENT * above[:3, 2]
    return Trajectory(
        np.insert(path.t, 0, path.t[0] - DESCENT / _DESCENT_SPEED), np.concatenate([above[None], path.base_T_tip])
    )


@dataclass(frozen=True, eq=False)
class Reflex:
    """How far the tip is lifted along its beam above the planned path, from one measurement to the next.

        reflex, path = Reflex(), add_descent(plan.path)
        while the tip moves along path:
            tip = reflex.raise_tip(path.at([now])[0])  # where it goes now, and what the samples carry
            reflex = reflex.update(ranges, status, elapsed)  # what the modules measured there

    A range below `closest`, or a target that its module finds too near to measure, starts a rise, which ends when all
    is `clear` away. So does a module that returns nothing where it has just seen something nearer than `clear`. The tip
    sinks back only while a module measures something and nothing that any module last saw comes nearer than `clear`;
    without a return it stays where it is.

    Attributes:
        closest: shortest range that is left alone, in metres: more than the 10 mm that `scan.guarded` asks for, since
            modules misread what is nearer (a VL6180X's ranges then wander up to 23 mm).
        clear: the range that ends a rise, and down to which the tip sinks back, in metres.
        lift_speed: how fast the tip rises, in metres per second.
        sink_speed: how fast it sinks back, in metres per second.
        highest: largest lift, in metres; a sensor that is stuck lifts no further.
        too_near: status codes that mean that the target is too near.
        lift: how far the tip is lifted now, in metres; never below 0.
        rising: whether a rise is under way.
        ahead: (m,) what each module saw last, in metres along its beam from the tip as lifted now; inf: nothing yet.
    """

    closest: float = 0.015
    clear: float = 0.025
    lift_speed: float = 0.15
    sink_speed: float = 0.025
    highest: float = 0.10
    too_near: tuple[int, ...] = (RANGE_UNDERFLOW,)
    lift: float = 0.0
    rising: bool = False
    ahead: Array = field(default_factory=lambda: np.full(1, np.inf))

    def update(self, ranges: ArrayLike, status: ArrayLike, elapsed: float) -> Reflex:
        """The reflex after the modules' last measurements, which holds for the next `elapsed` s.

        Args:
            ranges: (m,), or one module's; m along the beam; NaN: no return.
            status: (m,), the sensor's own status codes; 0 is good.
        """
        metres, codes = np.atleast_1d(np.asarray(ranges, dtype=np.float64)), np.atleast_1d(np.asarray(status))
        measured = np.isfinite(metres) & (codes == STATUS_OK)
        close = np.isin(codes, self.too_near) | (metres < self.closest)
        ahead = np.where(measured, metres, np.where(close, 0.0, self.ahead))
        unclear = ahead < self.clear
        rising = bool((close | (unclear & (self.rising | ~measured))).any())
        if rising:
            lift = min(self.lift + self.lift_speed * elapsed, max(self.highest, self.lift))
        elif measured.any():
            sunk = min(self.sink_speed * elapsed, float(ahead.min()) - self.clear)
            lift = max(self.lift - max(sunk, 0.0), 0.0)
        else:
            lift = self.lift
        return replace(self, lift=lift, rising=rising, ahead=ahead + (lift - self.lift))

    def raise_tip(self, base_T_tip: Array) -> Array:
        """The planned pose (4, 4) of the tip in base, lifted against the beam."""
        raised = base_T_tip.copy()
        raised[:3, 3] -= self.lift * base_T_tip[:3, 2]
        return raised
