"""The table of a calibration is read on any terminal."""

from __future__ import annotations

from io import StringIO

from pretouch_sensor_gateway.calibration.model import ModuleCalibration
from pretouch_sensor_gateway.calibration.record import ModuleFit, Point, StandardErrors
from pretouch_sensor_gateway.calibration.table import build_table
from rich.console import Console


def test_the_table_fits_sixty_columns() -> None:
    points = (Point(0.05, 0.0623, 0.001, 60, residual=0.0112), Point(0.1, 0.1123, 0.001, 60, (0.2,), -0.0112))
    errors = StandardErrors(0.00012, 0.0012, 12.3, 0.00012)
    fit = ModuleFit(ModuleCalibration(-0.01234, 0.9876, 123.4, 0.00234, 0.0345), errors, points=points)
    screen = StringIO()
    Console(file=screen, width=60).print(build_table([fit] * 12))
    text = screen.getvalue()
    assert "…" not in text
    for shown in ("-12.34", "±0.12", "0.9876", "±0.0012", "123.4", "±12.3", "12.3 → 11.2"):
        assert text.count(shown) >= 12
