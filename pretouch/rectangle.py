"""The rotated rectangle, a region of the depth image whose perimeter the finger scans, and one that is proposed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pretouch.errors import InvalidInput
from pretouch.geometry import Array, frozen_array


@dataclass(frozen=True)
class RotatedRectangle:
    """A rotated rectangle `[x, y, w, h, theta]` in a depth image.

    theta is normalised to [-pi/2, pi/2): half a turn leaves the rectangle as it is.

    Attributes:
        x: centre along u, in pixels.
        y: centre along v, in pixels.
        w: side along theta, in pixels.
        h: side across theta, in pixels.
        theta: angle from +u towards +v, in radians, in [-pi/2, pi/2).

    Raises:
        Malformed: a value is not finite.
        InvalidInput: a side is not positive.
    """

    x: float
    y: float
    w: float
    h: float
    theta: float

    def __post_init__(self) -> None:
        for name in ("x", "y", "w", "h", "theta"):
            object.__setattr__(self, name, float(frozen_array(getattr(self, name), (), f"rectangle.{name}")))
        if self.w <= 0 or self.h <= 0:
            raise InvalidInput(f"The rectangle's sides are {self.w:g} and {self.h:g}.", "Send sides greater than zero.")
        theta = (self.theta + np.pi / 2) % np.pi - np.pi / 2
        object.__setattr__(self, "theta", -np.pi / 2 if theta >= np.pi / 2 else float(theta))

    def as_list(self) -> list[float]:
        return [self.x, self.y, self.w, self.h, self.theta]

    def corners(self) -> Array:
        """(4, 2) as (u, v), in order along the perimeter, the first at (-w/2, -h/2) in the rectangle's own axes."""
        c, s = np.cos(self.theta), np.sin(self.theta)
        local = 0.5 * np.array([[-self.w, -self.h], [self.w, -self.h], [self.w, self.h], [-self.w, self.h]])
        return np.asarray(local @ np.array([[c, s], [-s, c]]) + (self.x, self.y), dtype=np.float64)

    def perimeter(self, spacing: float = 1.0) -> Array:
        """(n, 2) points along the perimeter, closed, at most `spacing` pixels apart, corners included."""
        corners = self.corners()
        sides = []
        for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            steps = max(1, int(np.ceil(np.linalg.norm(end - start) / spacing)))
            sides.append(start + (end - start) * (np.arange(steps) / steps)[:, None])
        return np.concatenate([*sides, corners[:1]])

    def distance(self, pixels: ArrayLike) -> Array:
        """Distance (...,), px, of pixels (..., 2) from the perimeter: negative inside, positive outside."""
        offset = np.asarray(pixels, dtype=np.float64) - (self.x, self.y)
        c, s = np.cos(self.theta), np.sin(self.theta)
        a = np.abs(c * offset[..., 0] + s * offset[..., 1]) - self.w / 2
        b = np.abs(-s * offset[..., 0] + c * offset[..., 1]) - self.h / 2
        outside = np.hypot(np.maximum(a, 0), np.maximum(b, 0))
        return np.asarray(np.where((a <= 0) & (b <= 0), np.maximum(a, b), outside), dtype=np.float64)

    def shifted(self, du: float, dv: float) -> RotatedRectangle:
        """The same rectangle, its centre moved by (du, dv) pixels."""
        return RotatedRectangle(self.x + du, self.y + dv, self.w, self.h, self.theta)

    def scaled(self, factor: float) -> RotatedRectangle:
        """The same rectangle in an image whose pixels are `factor` times as many in each direction."""
        return RotatedRectangle(factor * self.x, factor * self.y, factor * self.w, factor * self.h, self.theta)


@dataclass(frozen=True)
class ProposedRegion:
    """A rectangle in the scene's pixels and the proposer's score in [0, 1], comparable within one answer only."""

    rectangle: RotatedRectangle
    confidence: float
