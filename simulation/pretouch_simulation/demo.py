"""A session from the robot's side, recorded together with the truth."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field
from typing import Any

from pretouch.client import ScanPiece, SyncClient, drive
from pretouch.geometry import Array
from pretouch.session import Budget, ScanPlan, Session, SessionRequest, Tolerance
from pretouch.tof import RangeSamples, Sensor
from pretouch_simulation.protocol import Case

Execute = Callable[[ScanPlan], Generator[ScanPiece, Any, Any]]
"""Makes a planned scan, and yields its samples, or where the gateway has them, piece by piece."""


@dataclass(eq=False)
class Recording:
    """One session as it went.

    Attributes:
        title: the object and how it was served.
        states: the session as opened, then after each scan.
        pace: how many times as fast as planned the robot moves.
        points: (n, 3), m, in base, for each scan: where the fingertip's beams ended.
        report: what the orchestrator's report of the session shows, once it has ended.
    """

    title: str
    case: Case
    pace: float = 1.0
    states: list[Session] = field(default_factory=list)
    points: list[Array] = field(default_factory=list)
    report: dict[str, Any] = field(default_factory=dict)

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

    def robot_seconds(self) -> list[float]:
        """s that the robot's scans so far take at the planned pace, in each state."""
        return [self.pace * state.budget_used.seconds for state in self.states]

    def scanned_pixels(self) -> list[Array]:
        """For each scan (n, 2), px: where in the depth image its beams ended."""
        base_T_camera = self.case.truth @ self.case.base_T_camera
        return [self.case.camera.project(base_T_camera.inverse().apply(points)) for points in self.points]


def request_for(
    case: Case, sensor: Sensor, budget: Budget | None = None, tolerance: Tolerance | None = None
) -> SessionRequest:
    """The robot's request: defaults except for its sensor, and for budget and tolerance if given."""
    return SessionRequest(
        case.camera,
        case.base_T_camera,
        depth_scale=1.0,
        sensor=sensor,
        budget=budget or Budget(),
        tolerance=tolerance or Tolerance(),
    )


def record(
    client: SyncClient[Any, Any],
    recording: Recording,
    request: SessionRequest,
    mask: bool,
    execute: Execute,
    measured: list[RangeSamples],
) -> Iterator[Recording]:
    """Drives a session on the recording's case to its end.

    Args:
        mask: whether the client marks the object; else the orchestrator finds it on the table.
        measured: where the robot keeps the samples of each of its scans.

    Yields:
        The recording, after each step.
    """
    case = recording.case
    session = client.create_session(request, case.depth.metres, case.mask if mask else None)
    for state in drive(client, session, execute):
        recording.states.append(state)
        recording.points += [_beam_ends(samples, request.sensor) for samples in measured[len(recording.points) :]]
        yield recording


def _beam_ends(samples: RangeSamples, sensor: Sensor) -> Array:
    return samples.beams(sensor).points()
