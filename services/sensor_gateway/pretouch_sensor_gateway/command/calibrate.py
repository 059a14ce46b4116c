"""`pretouch gateway calibrate`: calibrates a finger with a plate at known distances."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from pretouch.channel import open_sync_channel
from pretouch.cli import TlsCa, TlsCert, TlsKey, Token
from pretouch.errors import InvalidInput, Unavailable
from pretouch.interrupts import INTERRUPTED
from pretouch.results import check_file
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceStub
from pretouch_sensor_gateway.calibration.device_client import DeviceClient
from pretouch_sensor_gateway.calibration.drift import LEAST_SCANS, SCAN
from pretouch_sensor_gateway.calibration.file import load, save
from pretouch_sensor_gateway.calibration.model import MAX_WARM_UP, Calibration
from pretouch_sensor_gateway.calibration.readings import split_by_module
from pretouch_sensor_gateway.calibration.record import CalibrationRecord, ModuleFit
from pretouch_sensor_gateway.calibration.session import Plan, Session
from pretouch_sensor_gateway.calibration.table import build_table, remarks
from pretouch_sensor_gateway.command.defaults import DEFAULT_GATEWAY
from pretouch_sensor_gateway.command.measure_drift import measure_drift_through
from pretouch_sensor_gateway.transport.address import DEFAULT_BAUD

_LEAST_AFTER_INTERRUPTION = 2


def calibrate(
    gateway: Annotated[
        str | None, typer.Option(help="host:port of a running gateway.", show_default=DEFAULT_GATEWAY)
    ] = None,
    device: Annotated[str, typer.Option(help="The device's name.", show_default="the only one")] = "",
    port: Annotated[
        str | None,
        typer.Option(help="Read a device without a running gateway: its path, usb:VID:PID or socket://host:port."),
    ] = None,
    wire_format: Annotated[
        str, typer.Option("--format", help="With --port: the device's wire format; auto recognises it.")
    ] = "auto",
    baud: Annotated[int, typer.Option(help="With --port: bits a second of a real UART.")] = DEFAULT_BAUD,
    distances: Annotated[
        str, typer.Option(help="Distances of the plate from the finger's reference, mm, in the order of measuring.")
    ] = "15,20,30,40,50,60,80,100",
    samples: Annotated[int, typer.Option(min=20, max=10_000, help="Measurements at each distance.")] = 60,
    warm_up: Annotated[
        float,
        typer.Option(
            min=0,
            max=MAX_WARM_UP,
            help="Seconds that the modules need to get warm: waited first; and the gateway flags ranges that "
            "come sooner after the device's start.",
        ),
    ] = 60.0,
    drift: Annotated[
        bool,
        typer.Option(
            "--drift",
            help="Measure drift and warm-up instead, at one target that stands still, from the moment the device is "
            "switched on; added to the calibration in --out.",
        ),
    ] = False,
    minutes: Annotated[
        float, typer.Option(min=LEAST_SCANS * SCAN / 60, max=24 * 60, help="With --drift: how long to measure.")
    ] = 20.0,
    out: Annotated[Path, typer.Option(help="Where the calibration goes.")] = Path("calibration.json"),
    report: Annotated[Path, typer.Option(help="Where the picture of the fit goes, a .png file.")] = Path(
        "calibration.png"
    ),
    apply: Annotated[bool, typer.Option("--apply", help="Make the gateway use it at once, until it ends.")] = False,
    token: Token = None,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
) -> None:
    """Calibrate a finger's modules with a plate at known distances."""
    plan = Plan(_parse_distances(distances), samples, warm_up)

    def run(stub: Any) -> None:
        if drift:
            measure_drift_through(stub, device, minutes, out, apply)
        else:
            calibrate_through(stub, device, plan, out, report, apply, port)

    os.environ.setdefault("GRPC_VERBOSITY", "NONE")  # gRPC's own messages would disturb the prompts
    if port is None:
        with open_sync_channel(gateway or DEFAULT_GATEWAY, token, tls_ca, tls_cert, tls_key) as channel:
            run(SensorGatewayServiceStub(channel))
        return
    if gateway is not None or device or apply:
        raise InvalidInput(
            "--port reads a device without a running gateway.", "Leave out --gateway, --device and --apply."
        )
    from pretouch_sensor_gateway.command.local_gateway import run_local_gateway

    with run_local_gateway(port, wire_format, baud) as address, open_sync_channel(address) as channel:
        run(SensorGatewayServiceStub(channel))


def calibrate_through(
    stub: Any, device: str, plan: Plan, out: Path, report: Path, apply: bool, port: str | None = None
) -> None:
    """Runs the command on an open connection.

    Args:
        stub: a `SensorGatewayServiceStub` on a synchronous channel.
        device, plan, out, report, apply: as the options of `calibrate`.
        port: where the device is, if the gateway ends with the command.

    Raises:
        PretouchError: before anything is measured, if something is missing: matplotlib or scipy, a writable folder for
            the files, the gateway, the device, its ranges. Afterwards only if a file cannot be written, or the gateway
            refuses the calibration.
        typer.Exit: 130, interrupted before enough was measured for a fit.
    """
    fit_module, write_picture = _import_fit()
    for path in (out, report):
        check_file(path)
    if report.suffix.lower() != ".png":
        raise InvalidInput(f"{report.name} is no .png file.", "Give --report FILE.png.")
    console = Console(highlight=False)
    client = DeviceClient(stub, device)
    session = Session(client, plan, console, lambda question: console.input(question, markup=False))
    complete = session.run()
    measured = len(session.readings)
    if not complete:
        console.print(f"Interrupted: {measured} of {len(plan.distances)} distances were measured.")
        if measured < _LEAST_AFTER_INTERRUPTION:
            console.print(
                f"At least {_LEAST_AFTER_INTERRUPTION} are needed: nothing was saved, and what was measured is lost."
            )
            raise typer.Exit(INTERRUPTED)
    if not measured:
        raise InvalidInput("No distance was measured, and nothing was saved.", "Measure three distances or more.")
    columns = {distance: split_by_module(raw) for distance, raw in session.readings.items()}
    fits = tuple(
        fit_module({distance: column[k] for distance, column in columns.items()}) for k in range(session.modules)
    )
    modules = tuple(each.calibration for each in fits)
    calibration = Calibration(client.serial, plan.warm_up, modules, _drift_so_far(out, client.serial))
    record = CalibrationRecord(datetime.now(UTC).isoformat(timespec="seconds"), client.name, fits)
    save(out, calibration, record)
    console.print(build_table(fits))
    for remark in remarks(fits):
        console.print(remark, markup=False)
    console.print(f"Saved {out}.", markup=False, soft_wrap=True)
    write_picture(report, calibration, record)
    console.print(f"Drew {report}.", markup=False, soft_wrap=True)
    if apply:
        client.apply(calibration)
        console.print(f"The gateway uses it for {client.name} until it ends. To keep it, configure:", markup=False)
    elif port is None:
        console.print(
            "The gateway does not use it yet; its call Configure (here: --apply) needs no restart. Configure:"
        )
    else:
        console.print("To use it, configure a gateway:")
    console.print(f"\n{_configuration_lines(client.name, out, port)}", markup=False, soft_wrap=True)


def _drift_so_far(out: Path, serial: str) -> float | None:
    """What --drift has found for this board: it stays in the file that is replaced."""
    try:
        before, _ = load(out)
    except InvalidInput:
        return None
    return before.bias_std if before.serial == serial else None


def _import_fit() -> tuple[Callable[..., ModuleFit], Callable[..., None]]:
    """`fit_module` and `write_picture`, which need packages that the gateway itself does not need."""
    try:
        from pretouch_sensor_gateway.calibration.fit import fit_module
        from pretouch_sensor_gateway.calibration.picture import write_picture
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in ("scipy", "matplotlib"):
            raise
        raise Unavailable(
            f"Calibrating needs the package {error.name}, which is not installed.",
            "Run: pip install 'pretouch[calibrate]'",
        ) from error
    return fit_module, write_picture


def _parse_distances(text: str) -> tuple[float, ...]:
    """m, from comma-separated mm."""
    try:
        millimetres = [float(part) for part in text.split(",")]
    except ValueError:
        millimetres = []
    if not millimetres or not all(0 < each <= 10_000 for each in millimetres):
        raise InvalidInput(f"--distances {text!r} are not valid.", "Give millimetres, as 15,20,30,50,80.")
    if len(set(millimetres)) < len(millimetres):
        raise InvalidInput(f"--distances {text!r} names one twice.", "Name each distance once.")
    return tuple(round(each / 1000, 9) for each in millimetres)


def _configuration_lines(device: str, path: Path, port: str | None) -> str:
    """The lines of a gateway's TOML file that make it use the calibration."""
    key = device if re.fullmatch(r"[A-Za-z0-9_-]+", device) else json.dumps(device)
    address = "" if port is None else f"address = {json.dumps(port)}\n"
    return f"[devices.{key}]\n{address}calibration = {json.dumps(str(path.resolve()))}"
