"""The demo: a drill over REST, then a mug over gRPC, each with a finger on a serial line; then picture and report."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pretouch_registrar.engines import Engine
from rich.console import Console
from rich.live import Live

from pretouch.client import GrpcClient, RestClient, SyncClient
from pretouch.session import Budget, Tolerance
from pretouch.tof import Sensor
from pretouch_simulation.demo import Execute, Recording, record, request_for
from pretouch_simulation.demo_table import live_table
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.finger import FingerModel, realise
from pretouch_simulation.finger_link import FingerProcess
from pretouch_simulation.frame_demo import engine_variable
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.picture import save_picture
from pretouch_simulation.protocol import Case, generator, make_case
from pretouch_simulation.report import fetch_report, save_report
from pretouch_simulation.robot import GatewayRobot
from pretouch_simulation.services import Services

PACE = 8.0
"""How many times as fast as planned the simulated robot moves; its finger measures as much faster."""
_TIMEOUT = 60.0
_TOLERANCE = Tolerance(error=0.010)
"""The demo's camera is itself off by 2 to 3 mm, which no finger can tell apart from the object's place: 1 cm can be
promised at 95 %, the default of 3 mm cannot."""
_BUDGET = Budget(scans=20, fraction=0.6)
"""More than the default, so that a cup with a hidden handle converges too."""


@dataclass(frozen=True)
class Act:
    """One session of the demo: which object, through which of the two APIs."""

    object_name: str
    api: str


ACTS = (Act("drill", "REST"), Act("mug", "gRPC"))


def show(results: Path, seed: int, camera: CameraModel, model: FingerModel, engine: Engine, console: Console) -> None:
    """Runs the demo and writes its picture and report into `results`."""
    started = time.monotonic()
    sensor = realise(model, generator("finger-model", seed)).sensor
    cases = {act.object_name: make_case(act.object_name, MAKERS[act.object_name](), 0, seed, camera) for act in ACTS}
    recordings: list[Recording] = []
    with ExitStack() as stack:
        with console.status("Starting the fingers and the four services ..."):
            fingers = {
                name: stack.enter_context(_start_finger(case, model, seed, PACE * sensor.rate))
                for name, case in cases.items()
            }
            devices = [f"{name}={finger.port}" for name, finger in fingers.items()]
            services = stack.enter_context(Services(devices, engine_variable(engine)))
        _print(
            console,
            f"REST {services.rest}, gRPC {services.grpc}, gateway {services.gateway}.",
            f"The {camera} camera's extrinsics are wrong by up to 2 cm and 5 degrees per axis; no service knows how.",
            f"The robot moves {PACE:g} times as fast as planned, and its {model} finger measures as much faster.",
            f"Each asks for an error of at most {1000 * _TOLERANCE.error:g} mm at {_TOLERANCE.confidence:.0%}, and "
            "stops when it is told that this is reached.",
        )
        with Live(live_table(recordings), console=console, auto_refresh=False) as live:
            for act in ACTS:
                recordings.append(Recording(f"{act.object_name}, {act.api}", cases[act.object_name], PACE))
                for _ in _play(act, recordings[-1], services, fingers[act.object_name], sensor):
                    live.update(live_table(recordings), refresh=True)
                recordings[-1].report = fetch_report(services.rest, recordings[-1].last.id)
    if not console.is_terminal:
        _print(console, "")  # elsewhere the table ends without a line break
    _print(console, *(f"{recording.title}: {recording.end()}" for recording in recordings))
    _save_results(recordings, results, f"engine {engine}, {camera} camera, {model} finger, seed {seed}", console)
    _print(console, f"All of it took {time.monotonic() - started:.0f} s.")


def _play(
    act: Act, recording: Recording, services: Services, finger: FingerProcess, sensor: Sensor
) -> Iterator[Recording]:
    with GatewayRobot(finger, services.gateway, act.object_name, PACE) as robot, _open_client(act, services) as client:
        request = request_for(recording.case, sensor, _BUDGET, _TOLERANCE)
        execute: Execute = robot.stream if act.api == "REST" else robot.stream_spans
        yield from record(client, recording, request, False, execute, robot.measured)


def _open_client(act: Act, services: Services) -> SyncClient[Any, Any]:
    if act.api == "REST":
        return RestClient(services.rest, timeout=_TIMEOUT)
    return GrpcClient(services.grpc, timeout=_TIMEOUT)


@contextmanager
def _start_finger(case: Case, model: FingerModel, seed: int, rate: float) -> Iterator[FingerProcess]:
    with tempfile.TemporaryDirectory(prefix="pretouch-") as folder:
        world = Path(folder) / "world.npz"
        case.world.save(world)
        with FingerProcess.in_world(world, model.value, seed, rate) as finger:
            yield finger


def _save_results(recordings: Sequence[Recording], results: Path, how: str, console: Console) -> None:
    results.mkdir(parents=True, exist_ok=True)
    picture, report = results / "picture.png", results / "report.html"
    save_picture(recordings, picture)
    about = (
        f"Simulated objects, camera and finger; all four services as they are; {how}. The robot moved {PACE:g} times "
        "as fast as planned, and its seconds here are as it moved."
    )
    save_report(recordings, about, report)
    _print(
        console,
        "",
        f"{picture}: for each object the depth image with the regions in the order they were scanned; the camera's "
        "points before and after the correction, beside the true object and where the fingertip measured; and the "
        "error over the scans, as the estimate expected it and as it truly was.",
        f"{report}: the sessions' reports as the orchestrator makes them, in one file, beside the truth.",
    )


def _print(console: Console, *lines: str) -> None:
    """Prints the lines as they are: paths and addresses are never broken."""
    for line in lines:
        console.print(line, highlight=False, markup=False, soft_wrap=True)
