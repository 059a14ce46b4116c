"""Coverage, width and knocks of a camera's calibration in a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pretouch_simulation.reliability import save_small

_WORLDS = (
    "normal, fixed",
    "normal, moving",
    "heavy, moving",
    "camera, moving",
    "pose, moving",
    "15 % of the sessions wrong",
)


def save_picture(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Writes a PNG of the rows of camera-calibration.json."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.0, 4.2), layout="constrained")
    coverage, width, knocks = figure.subplots(1, 3)
    for row in rows:
        if row["world"] in _WORLDS:
            at = np.arange(1, len(row["coverage"]) + 1)
            coverage.plot(at, 100 * np.array(row["coverage"]), "o-", ms=3, lw=1, label=row["world"])
            width.plot(at, 1000 * np.array(row["translation"]), "o-", ms=3, lw=1, label=row["world"])
    coverage.axhspan(93, 97, color="0.9", zorder=0)
    coverage.set(title="truths in the prior's 95 % region, %", xlabel="session", ylim=(50, 101))
    width.set(title="the prior's standard deviation along an axis, mm", xlabel="session", ylim=(0, None))
    width.legend(fontsize=7)
    knocked = [row for row in rows if "flagged" in row]
    places = np.arange(len(knocked))
    knocks.barh(places, [100 * row["flagged"] for row in knocked])
    knocks.set_yticks(places, [row["world"] for row in knocked], fontsize=6)
    knocks.set(title="knocks told within two sessions, %", xlim=(0, 100))
    knocks.invert_yaxis()
    save_small(figure, path, 110)
