"""Simulated depth cameras: depth images of a world with the errors of several kinds of camera.

The services read no parameter of this package, so that they are not tested with what they were tuned to.
"""

from pretouch_simulation.depth_cameras.models import CameraModel, realise
from pretouch_simulation.depth_cameras.rendering import DepthCamera, Rendering

__all__ = ["CameraModel", "DepthCamera", "Rendering", "realise"]
