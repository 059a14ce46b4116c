"""`pretouch gateway calibrate --drift`: measures drift and warm-up at a target that stands still."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from pretouch.errors import InvalidInput
from pretouch.geometry import Array
from pretouch.results import check_file
from pretouch_sensor_gateway.calibration.device_client import DeviceClient
from pretouch_sensor_gateway.calibration.drift import HORIZON, SCAN, Drift, measure_drift
from pretouch_sensor_gateway.calibration.file import load, save
from pretouch_sensor_gateway.calibration.model import UNCALIBRATED, Calibration
from pretouch_sensor_gateway.calibration.record import CalibrationRecord


def measure_drift_through(stub: Any, device: str, minutes: float, out: Path, apply: bool) -> None:
    """Measures on an open connection, and adds what is found to the calibration in `out`, which may not exist yet.

    Args:
        stub: a `SensorGatewayServiceStub` on a synchronous channel.
        minutes: how long to measure.
        device, out, apply: as the options of `calibrate`.

    Raises:
        PretouchError: the file cannot be read or written, or is of another board or number of modules; the gateway or
            the device does not answer; no module saw the target all the time.
    """
    check_file(out)
    console = Console(highlight=False)
    before = load(out) if out.exists() else None
    client = DeviceClient(stub, device)
    if before is not None and before[0].serial not in ("", client.serial):
        raise InvalidInput(
            f"{out} is the calibration of board {before[0].serial}; {client.name} is {client.serial or 'without one'}.",
            "Name another file with --out, or connect that board.",
        )
    raw = _read(client, minutes, console)
    modules = raw.shape[1]
    calibration, record = before or (Calibration(client.serial, 0.0, (UNCALIBRATED,) * modules), None)
    if len(calibration.modules) != modules:
        raise InvalidInput(
            f"{out} describes {len(calibration.modules)} modules, the device has {modules}.", "Name another --out."
        )
    drifts = _find(calibration.distance(raw), client.rate, console)
    bias_std = float(np.sqrt(np.mean([drift.bias_std**2 for drift in drifts])))
    warm_up = max(drift.warm_up for drift in drifts)
    found = replace(calibration, bias_std=round(bias_std, 7), warm_up=warm_up or calibration.warm_up)
    save(out, found, record)
    _report(console, found, warm_up, record)
    console.print(f"Saved {out}.", markup=False, soft_wrap=True)
    if apply:
        client.apply(found)
        console.print(f"The gateway uses it for {client.name} until it ends.", markup=False)


def _read(client: DeviceClient, minutes: float, console: Console) -> Array:
    count = round(60 * minutes * client.rate)
    console.print(f"Measuring for {minutes:g} minutes: leave the finger and its target alone.")
    columns = (TextColumn("Drift"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("", total=count)
        return client.read(count, lambda done: progress.update(task, completed=done)).raw


def _find(ranges: Array, rate: float, console: Console) -> list[Drift]:
    """The drift of every module that saw the target; prints each, or why there is none."""
    drifts = []
    problem: InvalidInput | None = None
    for k, column in enumerate(ranges.T):
        try:
            drift = measure_drift(column, rate)
        except InvalidInput as error:
            problem = error
            console.print(f"Module {k}: {error.detail}", markup=False)
            continue
        drifts.append(drift)
        warm = f"warm after {drift.warm_up:.0f} s" if drift.warm_up else "no warming up seen"
        console.print(
            f"Module {k}: noise {1000 * drift.white_std:.2f} mm; means of {SCAN:g} s differ by "
            f"{1000 * drift.found:.2f} mm over {drift.span / 60:.0f} min; {warm}.",
            markup=False,
        )
    if problem is not None and not drifts:
        raise problem
    return drifts


def _report(console: Console, found: Calibration, warm_up: float, record: CalibrationRecord | None) -> None:
    console.print(
        f"The ranges of a scan share an error of {1000 * (found.bias_std or 0):.2f} mm, extrapolated to "
        f"{HORIZON / 3600:g} hours of use: the session's sensor.range_bias_std."
    )
    if warm_up:
        console.print(f"Ranges are flagged for {warm_up:.0f} s after the device's start.")
    if record is None:
        console.print("The modules themselves are not calibrated yet: run this command without --drift, too.")
