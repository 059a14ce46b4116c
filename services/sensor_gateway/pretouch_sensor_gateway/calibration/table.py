"""The result of a calibration as a table, with remarks on what is doubtful about it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from pretouch_sensor_gateway.calibration.record import ModuleFit

_SUSPICIOUS = 0.001
"""m: a larger residual that all modules share means that the plate was misplaced."""


def build_table(fits: Sequence[ModuleFit]) -> Table:
    """A row for each module: values, below them one standard error; how far off its means are, before and after.

    Below that, how far off they are by a curve that was fitted without them: the residual.
    """
    table = Table(box=SIMPLE_HEAD, padding=0, pad_edge=False)
    table.add_column("\n#", no_wrap=True)
    for title in (
        "offset\nmm",
        "scale\n",
        "cross-\ntalk 1/m²",
        "noise\nmm",
        "per m\nmm",
        "off by\nmm rms",
        "out-\nliers",
    ):
        table.add_column(title, justify="right", no_wrap=True)
    for k, fit in enumerate(fits):
        if fit.problem:
            table.add_row(str(k), "none", style="red")
            continue
        module, errors = fit.calibration, fit.errors
        before = _rms([point.mean - point.distance for point in fit.points])
        after = _rms([point.residual for point in fit.points])
        outliers = sum(len(point.outliers) for point in fit.points)
        table.add_row(
            str(k),
            f"{1000 * module.offset:.2f}\n±{1000 * errors.offset:.2f}",
            f"{module.scale:.4f}\n±{errors.scale:.4f}" if errors.scale else "1",
            f"{module.crosstalk:.1f}\n±{errors.crosstalk:.1f}" if module.crosstalk else "0",
            f"{1000 * module.std:.2f}\n±{1000 * errors.std:.2f}",
            f"{1000 * module.std_slope:.1f}",
            f"{1000 * before:.1f} → {1000 * after:.1f}\nnew {1000 * module.residual:.1f}",
            str(outliers),
        )
    return table


def remarks(fits: Sequence[ModuleFit]) -> list[str]:
    """What the table does not show: modules without a calibration, simplified models, a misplaced plate."""
    found = [f"Module {k} is not calibrated: {fit.problem}" for k, fit in enumerate(fits) if fit.problem]
    for count, text in ((1, "one distance tells the offset alone"), (2, "two distances tell offset and scale alone")):
        few = [str(k) for k, fit in enumerate(fits) if len(fit.points) == count and not fit.problem]
        if few:
            found.append(f"Module {', '.join(few)}: {text}; measure three or more.")
    glass = [k for k, fit in enumerate(fits) if fit.calibration.crosstalk]
    found += [
        f"Module {k}: with this crosstalk nothing beyond {1000 * fits[k].calibration.reach:.0f} mm can be measured."
        for k in glass
    ]
    return found + (_warn_of_misplaced(fits) or _warn_of_unexplained(fits))


def _warn_of_unexplained(fits: Sequence[ModuleFit]) -> list[str]:
    found = []
    for k, fit in enumerate(fits):
        off = _rms([point.residual for point in fit.points])
        noise = _rms([fit.calibration.std + fit.calibration.std_slope * point.distance for point in fit.points])
        if off > max(_SUSPICIOUS, noise) and not fit.problem:
            found.append(f"Module {k}: the model is still {1000 * off:.1f} mm off; were the distances right?")
    return found


def _warn_of_misplaced(fits: Sequence[ModuleFit]) -> list[str]:
    distances = sorted({point.distance for fit in fits for point in fit.points})
    shared = {
        distance: float(np.median([p.residual for fit in fits for p in fit.points if p.distance == distance]))
        for distance in distances
    }
    usual = float(np.median(np.abs(list(shared.values())))) if shared else 0.0
    return [
        f"At {1000 * distance:g} mm the modules are {1000 * residual:+.1f} mm off: was the plate there?"
        for distance, residual in shared.items()
        if len(shared) > 3 and abs(residual) > max(_SUSPICIOUS, 3 * usual)
    ]


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values else 0.0
