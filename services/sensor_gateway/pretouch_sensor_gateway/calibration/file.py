"""Saves and loads a calibration as a JSON file, which a person can read, and write with the first four members alone.

{
 "version": 2,
 "serial": "0102030405060708",
 "warm_up_s": 60.0,
 "bias_std_m": 0.0006,                                           may be left out: not measured
 "modules": [
  {"offset_m": 0.0031, "scale": 1.012, "crosstalk_per_m2": 0.0, "std_m": 0.0008, "std_slope": 0.011,
   "residual_m": 0.0004, "span_m": [0.015, 0.1], "corrections_m": [[0.015, 0.0002], ...],       these may be left out
   "mounting": {"tip_T_module": ..., ...}},                      see `mounting.py`; may be left out
  ...],
 "made": {"date": ..., "device": ..., "modules": [...]}          see `record.py`; may be left out
}

Version 1 had none of what may be left out but `made`, and is read.
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from pretouch.errors import InvalidInput, Malformed
from pretouch.wire.reader import Members, prefix_errors, read_integer, read_number, read_numbers, read_text
from pretouch_sensor_gateway.calibration.model import EVERYWHERE, Calibration, ModuleCalibration
from pretouch_sensor_gateway.calibration.mounting import PARAMETERS, Mounting
from pretouch_sensor_gateway.calibration.record import CalibrationRecord, ModuleFit, Point, StandardErrors

VERSION = 2
MAX_BYTES = 4 * 1024 * 1024
_READ = (1, 2)
_MODULE = {
    "offset": "offset_m",
    "scale": "scale",
    "crosstalk": "crosstalk_per_m2",
    "std": "std_m",
    "std_slope": "std_slope",
}
_MOUNTING = {"offset": "offset_m", "latency": "latency_s", "half_angle": "half_angle_rad", "decay": "decay_per_m"}
_POINT = ("distance_m", "mean_m", "std_m", "samples", "outliers_m", "residual_m")
_REMEDY = "Mend the file, or make a new one: pretouch gateway calibrate."


def save(path: Path, calibration: Calibration, record: CalibrationRecord | None = None) -> None:
    """Saves atomically: a reader sees either the old file or the new one, never half of it.

    Raises:
        InvalidInput: it cannot be written.
    """
    document = {
        "version": VERSION,
        "serial": calibration.serial,
        "warm_up_s": calibration.warm_up,
        **({} if calibration.bias_std is None else {"bias_std_m": calibration.bias_std}),
        "modules": [_module_to_json(module) for module in calibration.modules],
    }
    if record is not None:
        document["made"] = {
            "date": record.date,
            "device": record.device,
            "modules": [_fit_to_json(fit) for fit in record.modules],
        }
    half = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        try:
            with half.open("w", encoding="utf-8") as file:
                file.write(_layout(document) + "\n")
                file.flush()
                os.fsync(file.fileno())
            half.replace(path)
        finally:
            half.unlink(missing_ok=True)
    except OSError as error:
        raise InvalidInput(f"{path} cannot be written: {error.strerror}.", "Check the folder.") from error


def load(path: Path) -> tuple[Calibration, CalibrationRecord | None]:
    """Loads a calibration, and the record of how it was made if the file has one.

    Raises:
        InvalidInput: it cannot be read, or a member is missing, unknown, or of an invalid type or value.
        Malformed: it is not JSON (truncated, for example), or contains a number that is not finite.
    """
    try:
        return _read(path)
    except InvalidInput as error:
        raise type(error)(f"{path}: {error.detail}", _REMEDY) from error


def _read(path: Path) -> tuple[Calibration, CalibrationRecord | None]:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise InvalidInput(f"it cannot be read: {error.strerror}.") from error
    if len(data) > MAX_BYTES:
        raise InvalidInput("it is too large for a calibration.")
    try:
        document = json.loads(data, parse_constant=_not_finite, object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        raise Malformed(f"it is no JSON: {error}.") from error
    members = Members(document, "", ("version", "serial", "warm_up_s", "bias_std_m", "modules", "made"))
    version = members.integer("version")
    if version not in _READ:
        raise InvalidInput(f"version is {version}; this pretouch reads versions {_READ[0]} to {VERSION}.")
    modules = tuple(_module(item, f"modules[{k}]") for k, item in enumerate(members.items("modules")))
    bias = members.number("bias_std_m") if "bias_std_m" in members else None
    calibration = Calibration(members.text("serial"), members.number("warm_up_s"), modules, bias)
    return calibration, _record(members, modules) if "made" in members else None


def _module(value: object, path: str) -> ModuleCalibration:
    members = Members(value, path, (*_MODULE.values(), "residual_m", "span_m", "corrections_m", "mounting"))
    numbers = {name: members.number(member) for name, member in _MODULE.items()}
    residual = members.number("residual_m") if "residual_m" in members else 0.0
    start, end = members.numbers("span_m", 2) if "span_m" in members else EVERYWHERE
    items = members.items("corrections_m") if "corrections_m" in members else []
    pairs = [read_numbers(item, f"{path}.corrections_m[{n}]", 2) for n, item in enumerate(items)]
    corrections = tuple((place, added) for place, added in pairs)
    mounting = _mounting(members.get("mounting"), f"{path}.mounting") if "mounting" in members else None
    with prefix_errors(path):
        return ModuleCalibration(
            **numbers, residual=residual, corrections=corrections, span=(start, end), mounting=mounting
        )


def _mounting(value: object, path: str) -> Mounting:
    members = Members(value, path, ("tip_T_module", *_MOUNTING.values(), "covariance", "unobserved"))
    pose = members.pose("tip_T_module")
    rows = members.items("covariance")
    size = len(PARAMETERS)
    covariance = [read_numbers(row, f"{path}.covariance[{n}]", size) for n, row in enumerate(rows)]
    unobserved = tuple(read_text(item, f"{path}.unobserved[{n}]") for n, item in enumerate(members.items("unobserved")))
    with prefix_errors(path):
        numbers = {name: members.number(member) for name, member in _MOUNTING.items()}
        return Mounting(pose, **numbers, covariance=np.array(covariance), unobserved=unobserved)


def _mounting_to_json(mounting: Mounting) -> dict[str, Any]:
    pose = mounting.tip_T_module
    return {
        "tip_T_module": {"translation": pose.translation.tolist(), "rotation": pose.quaternion.tolist()},
        **{member: getattr(mounting, name) for name, member in _MOUNTING.items()},
        "covariance": mounting.covariance.tolist(),
        "unobserved": list(mounting.unobserved),
    }


def _module_to_json(module: ModuleCalibration) -> dict[str, Any]:
    document: dict[str, Any] = {member: getattr(module, name) for name, member in _MODULE.items()}
    document["residual_m"] = module.residual
    if module.span != EVERYWHERE:
        document["span_m"] = list(module.span)
    if module.corrections:
        document["corrections_m"] = [list(pair) for pair in module.corrections]
    if module.mounting is not None:
        document["mounting"] = _mounting_to_json(module.mounting)
    return document


def _record(document: Members, modules: tuple[ModuleCalibration, ...]) -> CalibrationRecord:
    members = document.members("made", ("date", "device", "modules"))
    date = members.text("date")
    try:
        datetime.fromisoformat(date)
    except ValueError as error:
        raise InvalidInput(f"made.date is {date!r:.40}, no ISO 8601 date.") from error
    fits = members.items("modules")
    if len(fits) != len(modules):
        raise InvalidInput(f"made.modules has {len(fits)} items, modules {len(modules)}.")
    pairs = enumerate(zip(modules, fits, strict=True))
    return CalibrationRecord(
        date, members.text("device"), tuple(_fit(module, fit, f"made.modules[{k}]") for k, (module, fit) in pairs)
    )


def _fit(module: ModuleCalibration, value: object, path: str) -> ModuleFit:
    members = Members(value, path, ("problem", "standard_errors", "step_m", "distances"))
    errors = members.members("standard_errors", tuple(_MODULE.values()))
    points = [_point(item, f"{path}.distances[{k}]") for k, item in enumerate(members.items("distances"))]
    return ModuleFit(
        module,
        StandardErrors(**{name: errors.number(member) for name, member in _MODULE.items()}),
        members.number("step_m"),
        tuple(points),
        members.text("problem"),
    )


def _point(value: object, path: str) -> Point:
    members = Members(value, path, _POINT)
    outliers = [read_number(item, f"{path}.outliers_m[{k}]") for k, item in enumerate(members.items("outliers_m"))]
    return Point(
        members.number("distance_m"),
        members.number("mean_m"),
        members.number("std_m"),
        read_integer(members.get("samples"), f"{path}.samples"),
        tuple(outliers),
        members.number("residual_m"),
    )


def _fit_to_json(fit: ModuleFit) -> dict[str, Any]:
    return {
        "problem": fit.problem,
        "standard_errors": {_MODULE[name]: value for name, value in asdict(fit.errors).items()},
        "step_m": fit.step,
        "distances": [
            {
                "distance_m": point.distance,
                "mean_m": point.mean,
                "std_m": point.std,
                "samples": point.samples,
                "outliers_m": list(point.outliers),
                "residual_m": point.residual,
            }
            for point in fit.points
        ],
    }


def _layout(value: Any, depth: int = 0) -> str:
    """JSON with a line for each member or item, except where all fit on one line."""
    whole = json.dumps(value, allow_nan=False)
    if not isinstance(value, dict | list) or (len(whole) <= 160 and depth):
        return whole
    margin = "\n" + " " * (depth + 1)
    if isinstance(value, dict):
        return (
            "{"
            + margin
            + f",{margin}".join(f"{json.dumps(name)}: {_layout(item, depth + 1)}" for name, item in value.items())
            + margin[:-1]
            + "}"
        )
    return "[" + margin + f",{margin}".join(_layout(item, depth + 1) for item in value) + margin[:-1] + "]"


def _not_finite(constant: str) -> float:
    raise Malformed(f"it holds {constant}, which is no number.")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    members = dict(pairs)
    if len(members) != len(pairs):
        names = [name for name, _ in pairs]
        raise InvalidInput(f"it has {max(names, key=names.count)!r:.80} twice in one object.")
    return members
