"""pretouch: a better object pose for any robot, from a time-of-flight sensor in its fingertip."""

__version__ = "0.1.0"
