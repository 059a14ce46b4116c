"""A session from the robot's side, recorded together with the truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from pretouch.client import SyncClient, drive
from pretouch.geometry import Array
from pretouch.session import Budget, Region, ScanPlan, Session, SessionRequest, Submission
from pretouch.tof import RangeSamples, Sensor
from pretouch_simulation.protocol import Case

Execute = Callable[[ScanPlan], tuple[Submission, RangeSamples]]
"""Makes a planned scan: returns what to submit, and the samples."""


@dataclass(eq=False)
class Recording:
    """One session as it went.

    Attributes:
        title: the object and how it was served.
        states: the session as opened, then after each scan.
        points: (n, 3), m, in base, for each scan: where the fingertip's beams ended.
    """

    title: str
    case: Case
    states: list[Session] = field(default_factory=list)
    points: list[Array] = field(default_factory=list)

    @property
    def last(self) -> Session:
        return self.states[-1]

    def end(self) -> str:
        """The state in which the session ended; unless it converged, the reason and the remedy."""
        reason = self.last.reason
        state = self.last.state.value
        return state if reason is None else f"{state}. {reason['detail']} {reason['remedy']}"

    def true_errors(self) -> list[float]:
        """m: the object's mean point error in each state."""
        return [self.case.error(state.estimate.base_T_correction) for state in self.states]

    def expected_errors(self) -> list[float]:
        """m: what each state's estimate says of its error."""
        return [state.estimate.expected_error for state in self.states]

    def scanned_regions(self) -> list[Region]:
        """The regions in the order in which they were scanned."""
        regions = {region.id: region for state in self.states for region in state.regions}
        return [regions[scan.region_id] for scan in self.last.scans]


def request_for(case: Case, sensor: Sensor, budget: Budget | None = None) -> SessionRequest:
    """The robot's request: defaults except for its sensor, and the budget if given."""
    return SessionRequest(case.camera, case.base_T_camera, depth_scale=1.0, sensor=sensor, budget=budget or Budget())


def record(
    client: SyncClient[Any, Any], recording: Recording, request: SessionRequest, mask: bool, execute: Execute
) -> Iterator[Recording]:
    """Drives a session on the recording's case to its end.

    Args:
        mask: whether the client marks the object; else the orchestrator finds it on the table.

    Yields:
        The recording, after each step.
    """
    case = recording.case
    session = client.create_session(request, case.depth.metres, case.mask if mask else None)

    def scan(plan: ScanPlan) -> Submission:
        submission, samples = execute(plan)
        recording.points.append(_beam_ends(samples, request.sensor))
        return submission

    for state in drive(client, session, scan):
        recording.states.append(state)
        yield recording


def _beam_ends(samples: RangeSamples, sensor: Sensor) -> Array:
    return samples.beams(sensor).points()
