"""`pretouch gateway sweep`: finds where the modules sit and how wide they see, from a sweep that a robot has flown."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import grpc
import numpy as np
import typer
from rich.console import Console

from pretouch.channel import open_sync_channel
from pretouch.cli import TlsCa, TlsCert, TlsKey, Token
from pretouch.errors import InvalidInput, Unavailable, from_rpc_error
from pretouch.geometry import Pose
from pretouch.results import check_file
from pretouch.tof import STATUS_OK, RangeSamples, Sensor
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceStub
from pretouch.wire.common import pose_from_proto, pose_to_proto, samples_from_proto
from pretouch_sensor_gateway.calibration.file import load, save
from pretouch_sensor_gateway.calibration.model import UNCALIBRATED, Calibration
from pretouch_sensor_gateway.calibration.mounting import Mounting
from pretouch_sensor_gateway.calibration.proto_conversion import calibration_from_proto, calibration_to_proto
from pretouch_sensor_gateway.command.defaults import DEFAULT_GATEWAY

_TIMEOUT = 30.0
"""s for one response."""


def sweep(
    start: Annotated[float, typer.Option("--from", help="Unix time at which the sweep began, s.")],
    end: Annotated[float, typer.Option("--to", help="Unix time at which it ended, s.")],
    gateway: Annotated[str, typer.Option(help="host:port of the running gateway.")] = DEFAULT_GATEWAY,
    device: Annotated[str, typer.Option(help="The device's name.", show_default="the only one")] = "",
    half_angle: Annotated[
        float, typer.Option(min=0, max=40, help="Half angle of the cone by the data sheet, degrees; 0: not known.")
    ] = 0.0,
    out: Annotated[Path, typer.Option(help="The calibration that it is added to.")] = Path("calibration.json"),
    apply: Annotated[bool, typer.Option("--apply", help="Make the gateway use it at once, until it ends.")] = False,
    token: Token = None,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
) -> None:
    """Find the modules' mounts and cones from a sweep over a step, flown with StreamPoints."""
    check_file(out)
    with open_sync_channel(gateway, token, tls_ca, tls_cert, tls_key) as channel:
        stub = SensorGatewayServiceStub(channel)
        try:
            sweep_through(stub, device, (start, end), float(np.radians(half_angle)), out, apply)
        except grpc.RpcError as error:
            raise from_rpc_error(error) from error


def sweep_through(stub: Any, device: str, span: tuple[float, float], half_angle: float, out: Path, apply: bool) -> None:
    """Runs the command on an open connection.

    Raises:
        PretouchError: the gateway refuses, there are too few ranges or no step in them, the file cannot be used.
        grpc.RpcError: the gateway does not answer.
    """
    console = Console(highlight=False)
    status = stub.GetStatus(pb.GetStatusRequest(device=device), timeout=_TIMEOUT)
    request = pb.GetSamplesRequest(device=device, to=span[1], **{"from": span[0]})
    samples = samples_from_proto(stub.GetSamples(request, timeout=_TIMEOUT).samples)
    mounts = [pose_from_proto(pose, "tip_t_module") for pose in status.configuration.tip_t_module]
    calibration, record = load(out) if out.exists() else (_calibration_of(status, len(mounts)), None)
    if len(calibration.modules) != len(mounts):
        raise InvalidInput(
            f"{out} describes {len(calibration.modules)} modules, the gateway {len(mounts)}.", "Name another --out."
        )
    range_std = status.sensor.range_std if status.HasField("sensor") else Sensor.range_std
    console.print(f"{len(samples)} samples of {len(mounts)} modules; each module takes up to some minutes.")
    found = tuple(
        replace(module, mounting=_fit(k, samples, mount, range_std, half_angle, console))
        for k, (module, mount) in enumerate(zip(calibration.modules, mounts, strict=True))
    )
    calibration = replace(calibration, modules=found)
    save(out, calibration, record)
    console.print(f"Saved {out}.", markup=False, soft_wrap=True)
    latency = float(np.median([module.mounting.latency for module in found if module.mounting is not None]))
    console.print(
        f"The ranges are {1000 * latency:.1f} ms late: what to add to the device's latency, if it is certain."
    )
    if apply:
        poses = [
            pose_to_proto(mount if module.mounting is None else module.mounting.tip_T_module)
            for mount, module in zip(mounts, found, strict=True)
        ]
        message = calibration_to_proto(calibration)
        stub.Configure(pb.ConfigureRequest(device=device, tip_t_module=poses, calibration=message), timeout=_TIMEOUT)
        console.print("The gateway uses it until it ends.")


def _calibration_of(status: pb.GetStatusResponse, modules: int) -> Calibration:
    """The calibration that the gateway uses, or one that says nothing."""
    if status.configuration.HasField("calibration"):
        return calibration_from_proto(status.configuration.calibration)
    return Calibration(status.identity.serial, 0.0, (UNCALIBRATED,) * modules)


def _fit(k: int, samples: RangeSamples, mount: Pose, range_std: float, half_angle: float, console: Console) -> Mounting:
    try:
        from pretouch_sensor_gateway.calibration.sweep_fit import Sweep, fit_sweep
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] != "scipy":
            raise
        raise Unavailable(
            "A sweep needs the package scipy, which is not installed.", "Run: pip install 'pretouch[calibrate]'"
        ) from error
    own = samples.module == k
    ranges = np.where(samples.status[own] == STATUS_OK, samples.range[own], np.nan)
    try:
        mounting, residual = fit_sweep(
            Sweep(samples.t[own], samples.base_T_tip[own], ranges), mount, range_std, half_angle
        )
    except InvalidInput as error:
        raise InvalidInput(f"Module {k}: {error.detail}", error.remedy) from error
    stds, place = mounting.stds, mounting.tip_T_module.translation
    beam = (mount.inverse() @ mounting.tip_T_module).rotation[:, 2]
    tilt = np.degrees([-beam[1], beam[0]])
    console.print(
        f"Module {k}: origin {1000 * place[0]:.1f} ± {1000 * stds['origin_x']:.1f}, {1000 * place[1]:.1f} ± "
        f"{1000 * stds['origin_y']:.1f} mm; beam turned by {tilt[0]:.1f} ± {np.degrees(stds['tilt_x']):.1f}, "
        f"{tilt[1]:.1f} ± {np.degrees(stds['tilt_y']):.1f} deg; half angle {np.degrees(mounting.half_angle):.1f} deg "
        f"± {100 * stds['log_half_angle']:.0f} %; latency {1000 * mounting.latency:.1f} ± "
        f"{1000 * stds['latency']:.1f} ms; offset {1000 * mounting.offset:.1f} ± {1000 * stds['offset']:.1f} mm; "
        f"residual {1000 * residual:.1f} mm.",
        markup=False,
    )
    if mounting.unobserved:
        console.print(f"Not told by this sweep: {', '.join(mounting.unobserved)}.", markup=False)
    return mounting
