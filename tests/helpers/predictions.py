"""What a registrar predicts of scans of whole paths."""

from __future__ import annotations

from collections.abc import Sequence

from pretouch_registrar.registration import Registrar, Settings

from pretouch.scan_prediction import Candidate
from pretouch.scene import Scene
from pretouch.tof import Scan
from pretouch.trajectory import Trajectory


def predict_errors(
    registrar: Registrar, scene: Scene, scans: Sequence[Scan], settings: Settings, paths: Sequence[Trajectory]
) -> list[float]:
    """m: the expected error after a scan of each path."""
    predictions = registrar.predict(scene, scans, settings, [Candidate(path) for path in paths])
    return [whole.expected_error for (whole,) in predictions]
