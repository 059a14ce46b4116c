"""Draws a calibration: each module's residuals before and after, its noise, and its parameters."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pretouch.errors import InvalidInput
from pretouch.geometry import Array
from pretouch_sensor_gateway.calibration.model import Calibration
from pretouch_sensor_gateway.calibration.record import CalibrationRecord, ModuleFit

_BEFORE, _AFTER, _OUTLIER = "#5f6b76", "#00798c", "#d1495b"
_ROW = 2.1
"""inches"""


def write_picture(path: Path, calibration: Calibration, record: CalibrationRecord) -> None:
    """Writes a .png with a row for each module.

    From left to right: reading minus distance with the fitted curve and the outliers; calibrated mean minus distance;
    noise of the calibrated ranges with the fitted line, and with the curve's residual; parameters with standard errors.
    Error bars are one standard deviation of a single reading on the left, of the mean in the middle.

    Raises:
        InvalidInput: another suffix, or a folder that cannot be written to.
    """
    if path.suffix.lower() != ".png":
        raise InvalidInput(f"{path.name} is no .png file.", "Give --report FILE.png.")
    rows = len(record.modules)
    figure = Figure(figsize=(14, 0.9 + _ROW * rows), layout="constrained")
    panels = figure.subplots(rows, 4, squeeze=False, width_ratios=(3, 3, 3, 2.1))
    for k, fit in enumerate(record.modules):
        *plots, text = panels[k]
        for panel, draw in zip(plots, (_draw_before, _draw_after, _draw_noise), strict=True):
            panel.grid(alpha=0.3)
            if fit.problem:
                panel.set(xticks=[], yticks=[])
            else:
                draw(panel, fit)
        plots[0].set_ylabel(f"module {k}", fontweight="bold")
        text.axis("off")
        text.text(0, 0.98, _parameters(fit), va="top", fontsize=8.5, family="monospace", transform=text.transAxes)
    titles = ("reading - distance [mm]", "calibrated mean - distance [mm]", "noise of a range, one std [mm]")
    for panel, title in zip(panels[0], titles, strict=False):
        panel.set_title(title, fontsize=10)
    for panel in panels[-1][:3]:
        panel.set_xlabel("distance of the plate [mm]")
    figure.legend(handles=_legend(), loc="outside lower center", ncols=5, fontsize=9, frameon=False)
    board = f", board {calibration.serial}" if calibration.serial else ""
    figure.suptitle(f"{record.device}{board}, {record.date}", fontsize=11)
    try:
        with matplotlib.rc_context({"savefig.dpi": 100}):
            figure.savefig(path)
    except OSError as error:
        raise InvalidInput(f"{path} cannot be written: {error.strerror}.", "Check the folder.") from error


def _legend() -> list[Line2D]:
    return [
        Line2D([], [], color=_BEFORE, marker="o", ls="", label="measured"),
        Line2D([], [], color=_AFTER, label="model; calibrated"),
        Line2D([], [], color=_OUTLIER, marker="x", ls="", label="outlier, left out (triangle: beyond the axis)"),
        Line2D([], [], color=_AFTER, ls=":", label="with the curve's residual"),
        Line2D([], [], color=_OUTLIER, ls="--", label="noise that rounding alone makes"),
    ]


def _draw_before(panel: Any, fit: ModuleFit) -> None:
    r, means, stds = _columns(fit)
    panel.errorbar(1000 * r, 1000 * (means - r), 1000 * stds, fmt="o", ms=3.5, lw=1, capsize=2, color=_BEFORE)
    dense = np.linspace(0, 1.05 * r.max(), 200)
    panel.plot(1000 * dense, 1000 * (fit.calibration.predict_reading(dense) - dense), lw=1.2, color=_AFTER)
    panel.axhline(0, lw=0.8, color="black")
    low, high = panel.get_ylim()
    off = np.array([(point.distance, value - point.distance) for point in fit.points for value in point.outliers])
    if len(off):
        x, y = 1000 * off.T
        margin = 0.04 * (high - low)
        for marker, shown in (("x", (y >= low) & (y <= high)), ("^", y > high), ("v", y < low)):
            heights = np.clip(y[shown], low + margin, high - margin)
            panel.plot(x[shown], heights, marker, ms=5, color=_OUTLIER, alpha=0.8)
    panel.set_ylim(low, high)


def _draw_after(panel: Any, fit: ModuleFit) -> None:
    r, _, stds = _columns(fit)
    residuals = np.array([point.residual for point in fit.points])
    errors = stds * fit.calibration.gain(r) / np.sqrt([point.samples for point in fit.points])
    panel.errorbar(1000 * r, 1000 * residuals, 1000 * errors, fmt="o", ms=3.5, lw=1, capsize=2, color=_AFTER)
    panel.axhline(0, lw=0.8, color="black")
    most = max(0.5, 1.15 * float(np.abs(1000 * residuals).max() + 1000 * errors.max()))
    panel.set_ylim(-most, most)


def _draw_noise(panel: Any, fit: ModuleFit) -> None:
    r, _, stds = _columns(fit)
    noise = stds * fit.calibration.gain(r)
    counts = np.array([max(point.samples - 1, 1) for point in fit.points])
    panel.errorbar(
        1000 * r, 1000 * noise, 1000 * noise / np.sqrt(2 * counts), fmt="o", ms=3.5, lw=1, capsize=2, color=_BEFORE
    )
    dense = np.linspace(0, 1.05 * r.max(), 2)
    module = fit.calibration
    panel.plot(1000 * dense, 1000 * (module.std + module.std_slope * dense), lw=1.2, color=_AFTER)
    panel.plot(1000 * r, 1000 * module.std_at(r), lw=1.2, ls=":", color=_AFTER)
    if fit.step:
        panel.axhline(1000 * fit.step / np.sqrt(12), lw=0.9, ls="--", color=_OUTLIER)
    panel.set_ylim(0, None)


def _columns(fit: ModuleFit) -> tuple[Array, Array, Array]:
    """Distances, means and standard deviations, m."""
    return (
        np.array([point.distance for point in fit.points]),
        np.array([point.mean for point in fit.points]),
        np.array([point.std for point in fit.points]),
    )


def _parameters(fit: ModuleFit) -> str:
    if fit.problem:
        return "not calibrated:\n" + "\n".join(textwrap.wrap(fit.problem, 34))
    module, errors = fit.calibration, fit.errors
    rms = 1000 * np.sqrt(np.mean([point.residual**2 for point in fit.points]))
    return "\n".join(
        (
            f"offset    {1000 * module.offset:8.3f} ± {1000 * errors.offset:.3f} mm",
            f"scale     {module.scale:8.4f} ± {errors.scale:.4f}",
            f"crosstalk {module.crosstalk:8.2f} ± {errors.crosstalk:.2f} 1/m²",
            f"noise     {1000 * module.std:8.3f} ± {1000 * errors.std:.3f} mm",
            f"  + slope {1000 * module.std_slope:8.2f} ± {1000 * errors.std_slope:.2f} mm/m",
            f"bend      {'yes' if module.corrections else 'no':>8}",
            f"residual  {rms:8.3f} mm rms",
            f"  between {1000 * module.residual:8.3f} mm rms",
            f"readings  {sum(point.samples for point in fit.points):8d}",
            f"outliers  {sum(len(point.outliers) for point in fit.points):8d}",
        )
    )
