"""A bounding volume hierarchy over triangles: where rays first meet them, and their places closest to points."""

from pretouch_simulation.bvh.triangles import NO_FACE, Triangles

__all__ = ["NO_FACE", "Triangles"]
