"""`pretouch scan register`: where is the object truly? From files of a camera's and of a finger's points."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from pretouch.errors import InvalidInput, Unavailable
from pretouch.estimate import Estimate
from pretouch.geometry import Plane, Pose, vector_from_rotation
from pretouch.prior import Prior
from pretouch.results import STANDARD_OUTPUT, check_file, write_json
from pretouch.tof import Sensor
from pretouch.wire.json import estimate_to_json
from pretouch_registrar.engines import Engine
from pretouch_registrar.prior_file import read_prior
from pretouch_registrar.registration import Registrar, Settings
from pretouch_registrar.scan_files import Given, read_scan, read_target

scan = typer.Typer(help="Scans in files.", no_args_is_help=True)


@scan.callback()
def _scan() -> None:
    """Scans in files."""


@scan.command("register")
def _register(
    target: Annotated[
        Path,
        typer.Argument(
            help="Where the object is believed to be, in base: a depth image (.npz with depth, fx, fy, cx, cy, "
            "base_T_camera, mask, and table if it is known), the object's cloud as a camera saw it (.ply, .pcd, .obj, "
            ".npz with points), or its mesh (.ply, .obj, .stl, .off, .glb, .3mf) at --object-pose."
        ),
    ],
    source: Annotated[
        list[Path],
        typer.Argument(
            help="What the finger measured, a scan a file, in base: .npz with origins, directions and ranges (NaN: a "
            "miss), or points in any of the formats."
        ),
    ],
    engine: Annotated[Engine, typer.Option(help="How scans are matched.")] = Engine.POSTERIOR,
    viewpoint: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            metavar="X Y Z", help="The camera's position in base, m.", show_default="the file's, else straight above"
        ),
    ] = None,
    table: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(
            metavar="NX NY NZ D",
            help="The table in base: unit normal x y z upwards, and the offset d of normal . p = d, m.",
            show_default="the file's, else level at the target's lowest points",
        ),
    ] = None,
    object_pose: Annotated[
        tuple[float, float, float, float, float, float, float] | None,
        typer.Option(
            metavar="X Y Z QX QY QZ QW", help="base_T_object of a mesh: m, and a quaternion.", show_default="identity"
        ),
    ] = None,
    translation_std: Annotated[
        float, typer.Option(help="How wrong the target may be: standard deviation per axis, m.")
    ] = Prior.translation_std,
    rotation_std: Annotated[float, typer.Option(help="The same for rotation, rad.")] = Prior.rotation_std,
    prior: Annotated[
        Path | None,
        typer.Option(
            help="What is believed instead of the two: a .json file with base_T_correction and covariance, or an "
            "earlier session's or --json's estimate. With a centroid, the covariance is carried to this target's."
        ),
    ] = None,
    range_std: Annotated[float, typer.Option(help="Standard deviation of one range, m.")] = Sensor.range_std,
    beam_half_angle: Annotated[
        float, typer.Option(help="Half angle of the beam's cone, rad; 0 is a thin beam.")
    ] = Sensor.beam_half_angle,
    report: Annotated[Path | None, typer.Option(help="Write a picture of before and after to this .png file.")] = None,
    out: Annotated[
        Path | None,
        typer.Option("--json", help="Where the estimate goes as JSON; - is standard output, then no table."),
    ] = None,
) -> None:
    """Correct an object's pose from files: a target as believed, and what the finger measured."""
    for path in (report, out):
        if path is not None:
            check_file(path)
    write_picture = _import_picture(report) if report is not None else None
    told = Console(stderr=True, soft_wrap=True, highlight=False, markup=False)
    base_T_object = Pose.from_quaternion(object_pose[:3], object_pose[3:]) if object_pose is not None else None
    given = Given(Plane(np.array(table[:3]), table[3]) if table is not None else None, viewpoint, base_T_object)
    scene = read_target(target, given, told.print)
    scans = [read_scan(path, scene.table, told.print) for path in source]
    believed = Prior(translation_std, rotation_std) if prior is None else read_prior(prior, scene.centroid)
    settings = Settings(engine, believed, Sensor(range_std=range_std, beam_half_angle=beam_half_angle))
    estimate = Registrar().register(scene, scans, settings)
    if sum(len(each) for each in scans) and not estimate.samples:
        told.print("No sample lies near the target: are both in base, in metres?")
    if estimate.sensor_problem:
        told.print(f"The samples are no measurements: {estimate.sensor_problem}")
    if report is not None and write_picture is not None:
        write_picture(report, scene, scans, estimate)
    corrected = estimate.base_T_correction @ base_T_object if base_T_object is not None else None
    if out is not None:
        write_json(out, estimate_to_json(estimate, corrected))
    if out != STANDARD_OUTPUT:
        Console().print(_table(estimate, corrected))


def _import_picture(path: Path) -> Callable[..., None]:
    """`write_picture`, which needs matplotlib, if `path` is one that it writes."""
    if path.suffix.lower() != ".png":
        raise InvalidInput(f"{path.name} is no .png file.", "Give --report FILE.png.")
    try:
        from pretouch_registrar.report_picture import write_picture
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] != "matplotlib":
            raise
        raise Unavailable(
            "--report needs matplotlib, which is not installed.", "Run: pip install 'pretouch[report]'"
        ) from error
    return write_picture


def _table(estimate: Estimate, base_T_object: Pose | None) -> Table:
    turn = vector_from_rotation(estimate.base_T_correction.rotation)
    shift = estimate.base_T_correction.apply(estimate.centroid) - estimate.centroid
    table = Table(show_header=False)
    angle = float(np.linalg.norm(turn))
    axis = f" about ({', '.join(f'{x:.2f}' for x in turn / angle)})" if angle > 1e-6 else ""
    table.add_row("translation of the object's middle", f"{_millimetres(shift)} mm")
    table.add_row("rotation", f"{np.degrees(angle):.2f} deg{axis}")
    table.add_row("expected error", f"{1000 * estimate.expected_error:.2f} mm")
    table.add_row("95 % of errors below", f"{1000 * estimate.error_quantile:.2f} mm")
    table.add_row("inliers", f"{estimate.inliers} of {estimate.samples} samples")
    table.add_row("rmse of the inliers", f"{1000 * estimate.rmse:.2f} mm")
    table.add_row("fit (p-value of the samples)", f"{estimate.fit:.3g}")
    for k, mode in enumerate(estimate.modes[1:]):
        middle = mode.base_T_correction.apply(estimate.centroid) - estimate.centroid
        table.add_row("" if k else "other places", f"{_millimetres(middle)} mm, weight {mode.weight:.2f}")
    for k, weak in enumerate(estimate.unobservable):
        table.add_row("" if k else "still free", weak.text)
    if base_T_object is not None:
        numbers = [*base_T_object.translation, *base_T_object.quaternion]
        table.add_row("base_T_object (x y z, x y z w)", " ".join(f"{x:.5f}" for x in numbers))
    return table


def _millimetres(vector: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    return "(" + ", ".join(f"{1000 * value:.2f}" for value in vector) + ")"
