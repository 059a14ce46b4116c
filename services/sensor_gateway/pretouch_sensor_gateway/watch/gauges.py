"""Ranges as characters: a bar for the newest, a sparkline for the recent ones."""

from __future__ import annotations

import math
from itertools import groupby
from operator import itemgetter

import numpy as np
from rich.text import Text

from pretouch_sensor_gateway.watch.trace import Summary

FULL = 0.1
"""Metres of a full bar."""
_WHOLE, _HALF, _BEYOND, _TRACK = "━╸▶─"
_LEVELS = "▁▂▃▄▅▆▇"
_MISS = "·"
_LEAST_HEIGHT = 0.01
"""Metres of a sparkline's full height at the least, so that noise does not look like motion."""


def draw_bar(metres: float, width: int, style: str) -> Text:
    """A bar of 0 to `FULL` on its track; none for NaN, and an arrow at the end for what lies beyond."""
    if math.isnan(metres):
        return Text(_TRACK * width, "dim")
    if metres > FULL:
        return Text(_WHOLE * (width - 1) + _BEYOND, style)
    whole, half = divmod(round(2 * width * max(metres, 0.0) / FULL), 2)
    filled = _WHOLE * whole + _HALF * half
    return Text.assemble((filled, style), (_TRACK * (width - len(filled)), "dim"))


def draw_sparkline(summary: Summary, module: int) -> Text:
    """One character per column; its height is the mean range, between the least and the greatest shown.

    A dot is a column of misses only, a blank is one without any measurement; a column with some misses is coloured.
    """
    mean, returns = summary.mean[:, module], summary.returns[:, module]
    low = float(np.nanmin(mean, initial=np.inf))
    height = max(float(np.nanmax(mean, initial=-np.inf)) - low, _LEAST_HEIGHT)
    marks = []
    columns = zip(mean.tolist(), returns.tolist(), summary.measurements.tolist(), strict=True)
    for metres, returned, measured in columns:
        if returned:
            level = min(int((metres - low) / height * len(_LEVELS)), len(_LEVELS) - 1)
            marks.append((_LEVELS[level], "cyan" if returned == measured else "yellow"))
        else:
            marks.append((_MISS, "yellow") if measured else (" ", ""))
    text = Text()
    for style, run in groupby(marks, key=itemgetter(1)):
        text.append("".join(mark for mark, _ in run), style)
    return text
