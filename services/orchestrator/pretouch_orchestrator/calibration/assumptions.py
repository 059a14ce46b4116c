"""What the estimator assumes of cameras before it has seen any: chosen on simulated campaigns of its own seeds."""

from __future__ import annotations

import numpy as np

from pretouch.geometry import Array
from pretouch.prior import Prior

MAX_OBSERVATIONS = 100
"""The latest sessions that are looked at; under the random walk older ones would add next to nothing."""

SIDE = Prior()
"""Each side's error about the objects: the default calibration error."""

WALK_TRANSLATION, WALK_ROTATION = 1.5e-4, np.radians(0.02)
"""m and rad, standard deviations of the random walk of each side from session to session, about the objects."""

TRANSLATION_STDS: Array = np.array([0.0006, 0.0015, 0.003, 0.006, 0.015])
ROTATION_STDS: Array = np.radians([0.15, 0.4, 0.8, 1.6, 4.0])
"""m and rad: what may differ from session to session, and how probable each is before the first session."""
TRANSLATION_WEIGHTS: Array = np.array([0.2, 0.33, 0.32, 0.12, 0.03])
ROTATION_WEIGHTS: Array = np.array([0.05, 0.4, 0.38, 0.14, 0.03])
"""Sessions that state their rotations too widely hide how much differs: small residuals must not be preferred."""

ABOUT_CAMERA = 0.1
"""Chance that what differs from session to session turns about the camera's origin instead of the objects."""
CAMERA_ROTATION_WEIGHTS: Array = np.array([0.5, 0.39, 0.1, 0.009, 0.001])
"""As `ROTATION_WEIGHTS`, for such cameras: the objects are a metre away."""

NOISE_SCALES: Array = np.array([1.0, 3.0])
"""How wrong a session's stated standard deviations may be. None is taken to be better than it states, though many are:
with that freedom predictions are too sure of rotations that all sessions state too widely."""
NOISE_WEIGHTS: Array = np.array([0.9, 0.05])
WRONG_WEIGHT = 0.05
WRONG = (Prior(translation_std=0.007, rotation_std=0.025), Prior(translation_std=0.02, rotation_std=0.08))
"""A session that is simply wrong, and how often that happens."""

KNOCK = 1 / 50
"""Chance that the camera is knocked between two sessions."""
MOVED = 0.06
"""Probability from which a knock is told: chosen by the rate of false alarms."""
PUSHED = 0.7
"""Share of the knocks that push it only a little."""
PUSH_TRANSLATION, PUSH_ROTATION = 0.008, np.radians(1.2)
"""m and rad, standard deviations of such a push on each side, about the objects."""
INHERITED = 0.8
"""Share of the cameras in which what differs from session to session is after a knock as it was before."""
REDECLARED = 0.5
"""The same where the client declares another pose for a camera that was declared to be at one place before."""
FIXED_SESSIONS = 2
"""Sessions at one declared pose that make a fixed camera."""
SAME_POSITION, SAME_ROTATION = 1e-3, 1e-3
"""m and rad: declared poses that differ by less are the same."""
