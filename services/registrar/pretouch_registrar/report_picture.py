"""A picture of a registration: the target and the finger's points, from above and from the side, before and after."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from pretouch.errors import InvalidInput
from pretouch.estimate import Estimate
from pretouch.geometry import Array
from pretouch.scene import Scene
from pretouch.tof import Scan

_MAX_POINTS = 4000
"""Points drawn of each cloud."""
_VIEWS = (("from above", 0, 1), ("from the side", 0, 2))
_TARGET, _BEFORE, _AFTER = "#9aa4ad", "#d1495b", "#00798c"


def write_picture(path: Path, scene: Scene, scans: Sequence[Scan], estimate: Estimate) -> None:
    """Writes a .png: the target stays, the finger's points are moved onto it by the inverse of the correction.

    Raises:
        InvalidInput: it cannot be written.
    """
    target = _subsample(scene.cloud)
    before = _subsample(Scan.concatenate(list(scans)).points())
    after = estimate.base_T_correction.inverse().apply(before)
    figure = Figure(figsize=(11, 9), layout="constrained")
    panels = figure.subplots(2, 2)
    for row, (word, points, colour) in enumerate((("before", before, _BEFORE), ("after", after, _AFTER))):
        for panel, (view, x, y) in zip(panels[row], _VIEWS, strict=True):
            panel.scatter(target[:, x], target[:, y], s=3, c=_TARGET, linewidths=0, label="target")
            panel.scatter(points[:, x], points[:, y], s=9, c=colour, linewidths=0, label=f"source {word}")
            panel.set(title=f"{word}, {view}", xlabel=f"base {'xyz'[x]} [m]", ylabel=f"base {'xyz'[y]} [m]")
            panel.set_aspect("equal", "datalim")
            panel.grid(alpha=0.3)
            panel.legend(loc="upper right", markerscale=2)
    figure.suptitle(
        f"expected error {1000 * estimate.expected_error:.1f} mm, {estimate.inliers} of {estimate.samples} samples "
        f"agree, rmse {1000 * estimate.rmse:.1f} mm"
    )
    try:
        with matplotlib.rc_context({"savefig.dpi": 110}):
            figure.savefig(path)
    except OSError as error:
        raise InvalidInput(f"{path} cannot be written: {error.strerror}.", "Check the folder.") from error


def _subsample(points: Array) -> Array:
    return np.asarray(points[:: max(1, len(points) // _MAX_POINTS)], dtype=np.float64)
