"""What a camera's sessions together say about its calibration: a library without I/O.

Believed pose B of the camera in base, true pose G B E exp(xi): E the constant error on the camera's side, G the one on
the base's side, xi what differs from session to session. What it is worth:
docs/results/camera-calibration.md.
"""

from pretouch_orchestrator.calibration.calibration import Calibration, Drift, DriftState
from pretouch_orchestrator.calibration.estimator import estimate_calibration
from pretouch_orchestrator.calibration.observation import Observation

__all__ = ["Calibration", "Drift", "DriftState", "Observation", "estimate_calibration"]
