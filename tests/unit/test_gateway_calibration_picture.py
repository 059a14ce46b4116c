"""The picture of a fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pretouch_sensor_gateway.calibration.fit import fit_module
from pretouch_sensor_gateway.calibration.model import Calibration
from pretouch_sensor_gateway.calibration.picture import write_picture
from pretouch_sensor_gateway.calibration.record import CalibrationRecord, ModuleFit

from pretouch.errors import InvalidInput


def drawn(path: Path, *fits: ModuleFit) -> Image.Image:
    calibration = Calibration("0a", 60.0, tuple(fit.calibration for fit in fits))
    write_picture(path, calibration, CalibrationRecord("2025-01-31T12:00:00+00:00", "left", fits))
    with Image.open(path) as image:
        return image.convert("RGB")


def module(seed: int, count: int = 5) -> ModuleFit:
    rng = np.random.default_rng(seed)
    distances = np.linspace(0.02, 0.1, count)
    readings = {float(r): np.round(r + 0.003 + 0.001 * rng.standard_normal(40), 3) for r in distances}
    readings[0.02][3] = 0.15
    return fit_module(readings)


def coloured(image: Image.Image, colour: tuple[int, int, int]) -> int:
    return int((np.abs(np.asarray(image, dtype=int) - colour).sum(axis=2) < 12).sum())


def test_each_module_has_its_row(tmp_path: Path) -> None:
    one, six = (drawn(tmp_path / "a.png", *map(module, range(n))) for n in (1, 6))
    assert one.width == six.width >= 1200
    assert six.height > 4 * one.height
    teal = 0x00, 0x79, 0x8C
    assert coloured(six, teal) > 4 * coloured(one, teal) > 1000


def test_a_module_without_a_fit_and_one_with_a_single_distance_are_drawn(tmp_path: Path) -> None:
    image = drawn(tmp_path / "a.png", ModuleFit(problem="It returned too little at every distance."), module(0, 1))
    assert image.height > 400


def test_a_picture_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"a\.gif is no \.png file"):
        drawn(tmp_path / "a.gif", module(0))
    with pytest.raises(InvalidInput, match="cannot be written"):
        drawn(tmp_path / "none" / "a.png", module(0))
