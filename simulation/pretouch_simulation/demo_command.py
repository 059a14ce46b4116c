"""`pretouch demo`: two sessions through real services with a simulated robot; or one on a real depth frame."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from pretouch_registrar.engines import Engine
from rich.console import Console

from pretouch.errors import InvalidInput
from pretouch.results import STANDARD_OUTPUT, check_file, check_folder, write_json
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.finger import FingerModel
from pretouch_simulation.frame_demo import engine_variable, run_frame
from pretouch_simulation.frames import frame_case, load_frame
from pretouch_simulation.services import Services
from pretouch_simulation.show import show

RESULTS = Path("demo-results")
_SEED = (
    "Fixes the hidden calibration error, the depth image and the kind of finger, with --frame its noise too. Without "
    "--frame the finger runs in real time, so its samples, and what follows from them, differ a little in every run."
)


def demo(
    frame: Annotated[Path | None, typer.Option(help="A real depth frame's .json; left out: two made objects.")] = None,
    object_name: Annotated[str | None, typer.Option("--object", help="Which object of the frame.")] = None,
    seed: Annotated[int, typer.Option(help=_SEED)] = 0,
    camera: Annotated[
        CameraModel, typer.Option(help="The simulated depth camera before made objects.")
    ] = CameraModel.WINDOW,
    sensor: Annotated[FingerModel, typer.Option(help="The simulated fingertip.")] = FingerModel.IDEAL,
    engine: Annotated[Engine, typer.Option(help="How scans are matched.")] = Engine.POSTERIOR,
    out: Annotated[
        Path | None, typer.Option("--json", help="With --frame: where its result goes; - is standard output.")
    ] = None,
    results: Annotated[Path, typer.Option(help="Where picture and report go.")] = RESULTS,
) -> None:
    """Correct an object's pose with a simulated finger, through all four services.

    Camera and finger have errors that the services do not know.
    """
    if frame is None:
        if object_name is not None or out is not None:
            raise InvalidInput("--object and --json go with --frame.", "Add --frame FRAME.json, or leave them out.")
        check_folder(results)
        show(results, seed, camera, sensor, engine, Console())
        return
    if out is not None:
        check_file(out)
    _frame(frame, object_name, seed, sensor, engine, out)


def _frame(
    path: Path, object_name: str | None, seed: int, sensor: FingerModel, engine: Engine, out: Path | None
) -> None:
    loaded = load_frame(path)
    if object_name is None:
        names = ", ".join(thing.name for thing in loaded.objects)
        raise InvalidInput("--frame needs --object.", f"Choose from: {names}.")
    case = frame_case(loaded, object_name, seed)
    console = Console(stderr=out == STANDARD_OUTPUT)
    with console.status("Starting the services ..."), Services(environment=engine_variable(engine)) as services:
        console.print(f"{case.name}: {sensor} finger, engine {engine}, seed {seed}.", markup=False)
        result = run_frame(services, case, sensor)
    console.print(
        f"The camera was {1000 * result.initial_error:.1f} mm off, {1000 * result.final_error:.1f} mm are left "
        f"({1000 * result.expected_error:.1f} mm expected) after {result.scans} scans of {result.fraction:.1%} of the "
        f"object in {result.seconds:.1f} robot seconds. The session ended: {result.end}",
        markup=False,
    )
    if out is not None:
        write_json(out, result.as_dict())
