"""The record of how a calibration was made: the measurements, the fit, and its residuals."""

from __future__ import annotations

from dataclasses import dataclass

from pretouch_sensor_gateway.calibration.model import UNCALIBRATED, ModuleCalibration


@dataclass(frozen=True)
class Point:
    """The readings of one module with the plate at one distance.

    Attributes:
        distance: of the plate, m.
        mean, std: of the readings without the outliers, m.
        samples: how many these are.
        outliers: the readings that were left out, m.
        residual: by how much the calibrated mean exceeds the distance, m.
    """

    distance: float
    mean: float
    std: float
    samples: int
    outliers: tuple[float, ...] = ()
    residual: float = 0.0


@dataclass(frozen=True)
class StandardErrors:
    """Of the members of the same names of a `ModuleCalibration`, in their units; 0 for one that was not fitted."""

    offset: float = 0.0
    scale: float = 0.0
    crosstalk: float = 0.0
    std: float = 0.0
    std_slope: float = 0.0


@dataclass(frozen=True)
class ModuleFit:
    """One module's calibration and the measurements that it was fitted to.

    Attributes:
        calibration: the fitted model; `UNCALIBRATED` where there is a problem.
        errors: the standard errors of its members.
        step: m, the readings are multiples of it; 0 where none is visible.
        points: one for each distance, in their order.
        problem: why the module could not be calibrated; "" if it was.
    """

    calibration: ModuleCalibration = UNCALIBRATED
    errors: StandardErrors = StandardErrors()
    step: float = 0.0
    points: tuple[Point, ...] = ()
    problem: str = ""


@dataclass(frozen=True)
class CalibrationRecord:
    """All modules of a device.

    Attributes:
        date: when, ISO 8601 with its time zone.
        device: its name in the gateway.
        modules: one for each module, in their order.
    """

    date: str
    device: str
    modules: tuple[ModuleFit, ...]
