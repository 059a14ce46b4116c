"""A histogram of how near the finger came to things."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pretouch_simulation.reliability import save_small

from pretouch.geometry import Array

_BIN = 2.0
_SPAN = (-20.0, 100.0)
"""mm; what lies beyond counts in the outermost bars."""


def save_histogram(clearances: Mapping[str, Array], title: str, path: Path) -> None:
    """Writes a PNG: a panel for each name, with the least clearances of its scans, m."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.0, 2.6 * len(clearances)), layout="constrained")
    figure.suptitle(title, fontsize=10)
    edges = np.arange(_SPAN[0], _SPAN[1] + _BIN, _BIN)
    panels = figure.subplots(len(clearances), 1, squeeze=False, sharex=True)[:, 0]
    for axes, (name, metres) in zip(panels, clearances.items(), strict=True):
        axes.hist(np.clip(1000 * metres, edges[0], edges[-1] - 1e-6), edges, color="C0")
        axes.axvline(0.0, color="C3", lw=1)
        axes.set_title(f"{name}: {len(metres)} scans, {int((metres <= 0).sum())} contacts", fontsize=9)
        axes.set_ylabel("scans")
    panels[-1].set_xlabel("nearest approach, mm")
    save_small(figure, path, 95)
