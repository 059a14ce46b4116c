"""One session on a case through running services, the finger's samples taken straight from the world."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import asdict, dataclass
from typing import Any

from pretouch_registrar.engines import Engine

from pretouch.client import RestClient
from pretouch.geometry import Pose
from pretouch.session import ScanPlan
from pretouch.tof import RangeSamples
from pretouch_simulation.demo import Execute, Recording, record, request_for
from pretouch_simulation.finger import Finger, FingerModel, realise
from pretouch_simulation.protocol import Case, generator
from pretouch_simulation.scanning import cut_pieces, scan_along
from pretouch_simulation.services import Services

_TIMEOUT = 60.0


@dataclass(frozen=True)
class Result:
    """The result of a session; metres, and `seconds` of the robot's time; `end` is the state with its reason."""

    initial_error: float
    final_error: float
    expected_error: float
    scans: int
    fraction: float
    seconds: float
    state: str
    end: str

    def as_dict(self) -> dict[str, Any]:
        """For programs: all but `end`."""
        return {name: value for name, value in asdict(self).items() if name != "end"}


def engine_variable(engine: Engine) -> dict[str, str]:
    """The environment that makes the services' registrar match by `engine`."""
    return {"PRETOUCH_REGISTRAR_ENGINE": engine.value}


def run_frame(services: Services, case: Case, model: FingerModel) -> Result:
    """Runs a REST session on `case` to its end; the seed of the finger's noise is fixed by the case."""
    recording = Recording(case.name, case)
    with RestClient(services.rest, timeout=_TIMEOUT) as client:
        finger = finger_of(case, model)
        measured: list[RangeSamples] = []
        request = request_for(case, finger.sensor)
        for _ in record(client, recording, request, True, direct_finger(case, finger, measured), measured):
            pass
    last = recording.last
    return Result(
        initial_error=case.error(Pose.identity()),
        final_error=recording.true_errors()[-1],
        expected_error=last.estimate.expected_error,
        scans=last.budget_used.scans,
        fraction=last.budget_used.fraction,
        seconds=last.budget_used.seconds,
        state=last.state.value,
        end=recording.end(),
    )


def finger_of(case: Case, model: FingerModel) -> Finger:
    """The fingertip of the case's session."""
    return realise(model, generator("finger-model", case.name, case.view))


def direct_finger(case: Case, finger: Finger, measured: list[RangeSamples]) -> Execute:
    """A robot that makes scans of the case's world without spending time on them; it adds each to `measured`."""
    rng = generator("finger", case.name, case.view)

    def execute(plan: ScanPlan) -> Generator[RangeSamples, None, None]:
        taken: list[RangeSamples] = []
        try:
            for piece in cut_pieces(scan_along(case.world, plan.path, finger.sensor, finger, rng)):
                taken.append(piece)
                yield piece
        finally:
            measured.append(RangeSamples.concatenate(taken))

    return execute
