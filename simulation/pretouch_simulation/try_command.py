"""`pretouch try`: what pretouch makes of a depth image of your own, without a robot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from pretouch_orchestrator.perception.depth_check import USUAL_DEPTH
from pretouch_orchestrator.report.document import build_document
from pretouch_orchestrator.report.outcome import describe_forecast
from pretouch_orchestrator.report.page import render_page
from pretouch_orchestrator.sessions.record import Record
from rich.console import Console
from rich.table import Table

from pretouch.camera import Camera, DepthImage
from pretouch.client.images import load_depth, load_mask
from pretouch.errors import InvalidInput
from pretouch.geometry import Plane
from pretouch.results import check_file
from pretouch_simulation.try_picture import save_try_picture
from pretouch_simulation.try_session import OwnImage, open_session

_ABOUT = "What pretouch finds and would scan first. The table is taken to be level, as nobody said where the camera is."
_LARGE = 1.0
"""m: an object that is larger is most often a wrong scale, or more than one object."""
_FLAT = 15.0
"""deg: a camera that looks down on the table less than this sees too little of it."""
_ON_TABLE = (0.004, 0.3)
"""m, and share: an object of which more is lower than this has a mask that does not fit."""


def try_image(
    depth: Annotated[Path, typer.Argument(help="16-bit greyscale PNG, or .npy of uint16 or float32.")],
    fx: Annotated[float | None, typer.Option(help="Focal length, pixels.", show_default=False)] = None,
    fy: Annotated[float | None, typer.Option(help="Focal length, pixels.", show_default=False)] = None,
    cx: Annotated[float | None, typer.Option(help="Principal point, pixels.", show_default=False)] = None,
    cy: Annotated[float | None, typer.Option(help="Principal point, pixels.", show_default=False)] = None,
    depth_scale: Annotated[
        float | None,
        typer.Option(help="Metres of one stored unit.", show_default="0.001 for integers, 1 for floats"),
    ] = None,
    mask: Annotated[
        Path | None,
        typer.Option(help="PNG of the same size, non-zero on the object.", show_default="found on the table"),
    ] = None,
    roi: Annotated[
        tuple[int, int, int, int] | None,
        typer.Option(help="The object is within u0 v0 u1 v1, pixels, half-open.", show_default="the whole image"),
    ] = None,
    table: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(
            help="The table in the camera's frame (x right, y down, z forward): unit normal x y z towards the camera, "
            "and d of normal . p = d, m.",
            show_default="found",
        ),
    ] = None,
    at: Annotated[
        list[str] | None,
        typer.Option(
            metavar="X,Y,Z",
            help="A point in the camera's frame, m, where the error counts; up to 64 times.",
            show_default="the object's visible points",
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Where the picture goes, and beside it the report, as .html.")] = Path(
        "pretouch-try.png"
    ),
) -> None:
    """Show what pretouch finds and plans in a depth image of your own; no robot, no services.

    Where the camera stands is not asked: the table is taken to be level.
    """
    if out.suffix.lower() != ".png":
        raise InvalidInput(f"{out} is no .png file.", "Give --out FILE.png.")
    report = out.with_suffix(".html")
    for file in (out, report):
        check_file(file)
    camera = _camera({"fx": fx, "fy": fy, "cx": cx, "cy": cy})
    values = load_depth(depth)
    scale = depth_scale if depth_scale is not None else 0.001 if values.dtype == np.uint16 else 1.0
    image = OwnImage(
        DepthImage.from_values(values, scale),
        camera,
        load_mask(mask) > 0 if mask is not None else None,
        roi,
        Plane(np.array(table[:3]), table[3]) if table is not None else None,
        np.array([_read_point(text) for text in at]) if at else None,
    )
    told = Console(stderr=True, soft_wrap=True, highlight=False, markup=False)
    _warn_of_scale(image, scale, told)
    record = open_session(image)
    try:
        save_try_picture(record, image.depth, out)
        page = render_page("pretouch try", _ABOUT, [(depth.name, build_document(record, ()))])
        report.write_text(page, encoding="utf-8")
    except OSError as error:
        raise InvalidInput(f"{out} cannot be written: {error.strerror}.", "Give --out another path.") from error
    Console(highlight=False).print(_table(record, image))
    _warn_of_view(record, image, told)
    told.print(f"{out}: the object with its regions, and the first scan from above and from the side.")
    told.print(f"{report}: the same to turn and zoom, and the regions in numbers.")


def _read_point(text: str) -> list[float]:
    try:
        x, y, z = map(float, text.split(","))
    except ValueError:
        raise InvalidInput(f"--at {text!r:.60} is no point.", "Give three numbers, as --at 0.02,-0.01,0.75.") from None
    return [x, y, z]


def _camera(intrinsics: dict[str, float | None]) -> Camera:
    given = {name: value for name, value in intrinsics.items() if value is not None}
    missing = [f"--{name}" for name in intrinsics if name not in given]
    if missing:
        raise InvalidInput(
            f"The camera's intrinsics are not complete: {', '.join(missing)}.",
            "They are in the camera's calibration: the K of ROS's camera_info is [fx 0 cx, 0 fy cy, 0 0 1], RealSense "
            "calls them fx, fy, ppx, ppy. Take those of the depth image, at its own size; if it is registered to the "
            "colour image, those of that.",
        )
    return Camera(**given)


def _warn_of_scale(image: OwnImage, scale: float, told: Console) -> None:
    seen = image.depth.metres[image.depth.metres > 0]
    if not len(seen):
        return
    middle = float(np.median(seen))
    if not USUAL_DEPTH[0] <= middle <= USUAL_DEPTH[1]:
        told.print(
            f"Warning: with a depth scale of {scale:g} the image is {middle:.3g} m away in the median. Check "
            "--depth-scale: 0.001 for millimetres, 0.0001 for tenths of them, 1 for metres."
        )


def _warn_of_view(record: Record, image: OwnImage, told: Console) -> None:
    size = max(_size(record))
    if size > _LARGE:
        told.print(
            f"Warning: the object is {size:.2f} m large. Check --depth-scale, and mark the object with --mask or --roi."
        )
    down = _measure_degrees_down(record)
    if down < _FLAT:
        told.print(
            f"Warning: the camera looks only {down:.0f} degrees down on the table. Check the table in the picture; "
            "give --table if another plane was taken for it."
        )
    on_table = float((record.scene.cloud[:, 2] < _ON_TABLE[0]).mean())
    if on_table > _ON_TABLE[1]:
        told.print(
            f"Warning: {on_table:.0%} of the object's pixels lie on the table. Check that the mask belongs to this "
            "depth image, registered to it, and holds the object alone."
        )
    u0, v0, u1, v1 = _bounds(record)
    if u0 == 0 or v0 == 0 or u1 == image.depth.width or v1 == image.depth.height:
        told.print(
            "Warning: the object reaches the image's edge. If it is another thing than yours, give --mask or --roi; "
            "else take an image that shows all of it."
        )


def _table(record: Record, image: OwnImage) -> Table:
    scene, plan = record.scene, record.next_scan
    u0, v0, u1, v1 = _bounds(record)
    distance = float(np.linalg.norm(scene.centroid - scene.base_T_camera.translation))
    width, depth, height = (100 * size for size in _size(record))
    table = Table(show_header=False)
    found = "as masked" if image.mask is not None else "found"
    table.add_row("object", f"{found}: {int(scene.mask.sum())} pixels in {u0} {v0} {u1} {v1}")
    table.add_row("distance", f"{distance:.2f} m")
    table.add_row("size as seen", f"{width:.1f} x {depth:.1f} cm, {height:.1f} cm high")
    height_of_camera, down = scene.base_T_camera.translation[2], _measure_degrees_down(record)
    found = "as given" if image.table is not None else "found"
    table.add_row("table", f"{found}: {height_of_camera:.2f} m below the camera, seen {down:.0f} degrees down")
    table.add_row("regions", f"{len(record.regions)}, by proposer {record.proposer.value}")
    table.add_row("error expected now", f"{1000 * record.estimate.expected_error:.1f} mm, as a camera may be off")
    if plan is None:
        reason = record.reason or {}
        table.add_row("plan", f"none: {reason.get('detail', record.state.value)} {reason.get('remedy', '')}".strip())
        return table
    heights = 100 * plan.path.base_T_tip[:, 2, 3]
    table.add_row("first scan", f"{100 * plan.path.length:.0f} cm in {plan.path.duration:.1f} s along {plan.path_id}")
    table.add_row("fingertip", f"{heights.min():.1f} to {heights.max():.1f} cm above the table")
    table.add_row("expected returns", f"{plan.expected_returns:.0%} of its samples")
    if record.forecast is not None:
        table.add_row("forecast", describe_forecast(record.forecast))
    return table


def _bounds(record: Record) -> tuple[int, int, int, int]:
    """The object's bounding box (u0, v0, u1, v1) in the image, half-open."""
    (u0, v0), step = record.origin, record.step
    left, top, right, bottom = (step * edge for edge in record.scene.bounds())
    return u0 + left, v0 + top, u0 + right, v0 + bottom


def _size(record: Record) -> tuple[float, float, float]:
    """m: the seen object's length and width on the table, and its height, stray points left out."""
    points = record.scene.cloud
    flat = points[:, :2] - points[:, :2].mean(axis=0)
    axes = np.linalg.svd(flat, full_matrices=False)[2]
    sides = np.ptp(np.quantile(flat @ axes.T, (0.005, 0.995), axis=0), axis=0)
    return float(sides[0]), float(sides[1]), float(np.quantile(points[:, 2], 0.995))


def _measure_degrees_down(record: Record) -> float:
    return float(np.degrees(np.arcsin(np.clip(-record.scene.base_T_camera.rotation[2, 2], -1.0, 1.0))))
