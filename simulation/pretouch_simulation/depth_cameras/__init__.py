"""Simulated depth cameras: what a client gets of a world, with the errors of one kind of camera or another.

No number of this package is read by the services: what they are tested with must not be what they were told.
"""

from pretouch_simulation.depth_cameras.models import CameraModel, realise
from pretouch_simulation.depth_cameras.rendering import DepthCamera, Rendering

__all__ = ["CameraModel", "DepthCamera", "Rendering", "realise"]
