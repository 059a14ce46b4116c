"""The sessions of a campaign, one after the other, each of which starts from what those before found of the camera."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, NamedTuple

from pretouch_orchestrator.cameras.findings import calibrate, observe, predict_prior
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store.protocol import CameraEntry
from pretouch_registrar.registration import Registrar

from pretouch.errors import PretouchError
from pretouch.estimate import Estimate
from pretouch.geometry import Pose
from pretouch_simulation.campaign_world import Campaign
from pretouch_simulation.evaluation import Step, make_scans, open_session
from pretouch_simulation.evaluation_protocol import Protocol, loop_of
from pretouch_simulation.evaluation_rows import Row
from pretouch_simulation.protocol import Case


class CampaignKey(NamedTuple):
    """Identifies the run of a campaign within its evaluation.

    Attributes:
        learns: whether its sessions name their camera, so that they learn from each other.
    """

    campaign: int
    learns: bool
    engine: str
    sensor: str
    camera: str


@dataclass(frozen=True)
class CampaignRun:
    """The results of one campaign.

    Attributes:
        rows: of all its sessions in turn; a session that ended without a scan has one, with `scan` 0.
        problems: by position, why a session could not be made.
    """

    key: CampaignKey
    rows: tuple[Row, ...]
    problems: dict[int, str]

    def as_dict(self) -> dict[str, Any]:
        problems = {str(position): said for position, said in self.problems.items()}
        return {"key": self.key._asdict(), "rows": [row.as_dict() for row in self.rows], "problems": problems}

    @staticmethod
    def from_dict(values: dict[str, Any]) -> CampaignRun:
        problems = {int(position): said for position, said in values["problems"].items()}
        return CampaignRun(CampaignKey(**values["key"]), tuple(Row(**row) for row in values["rows"]), problems)


@dataclass(frozen=True, eq=False, repr=False)  # asyncio.run formats its result; with arrays that takes seconds
class CampaignSession:
    """A session from its opening to its end.

    Attributes:
        opening: s of computing until it was open.
        steps: after each of its scans.
    """

    opened: Record
    opening: float
    steps: tuple[Step, ...]

    @property
    def ended(self) -> Record:
        return self.steps[-1].record if self.steps else self.opened


def key_of(campaign: Campaign, protocol: Protocol, learns: bool) -> CampaignKey:
    """The key of the campaign's run by the protocol."""
    return CampaignKey(campaign.number, learns, protocol.engine.value, protocol.sensor.value, protocol.camera.value)


def run_campaign(campaign: Campaign, protocol: Protocol, learns: bool) -> CampaignRun:
    """Makes the campaign's sessions in turn.

    An error of pretouch's own is part of the result, and the campaign goes on with the next object; any other is
    raised.
    """
    rows, problems = list[Row](), dict[int, str]()
    for position, made in enumerate(make_sessions(campaign, protocol, learns), start=1):
        if isinstance(made, PretouchError):
            problems[position] = f"{made.detail} {made.remedy}".strip()
        else:
            rows += made
    return CampaignRun(key_of(campaign, protocol, learns), tuple(rows), problems)


def make_sessions(campaign: Campaign, protocol: Protocol, learns: bool) -> Iterator[list[Row] | PretouchError]:
    """The rows of each session in turn, or why it could not be made; the orchestrator's own code learns the camera."""
    registrar, entries = Registrar(), list[CameraEntry]()
    for position in range(1, campaign.settings.objects + 1):
        try:
            case = campaign.case(position, protocol.camera)
            session = asyncio.run(_make_session(campaign, case, protocol, registrar, entries))
        except PretouchError as error:
            yield error
            continue
        if learns:
            entry = observe(session.ended, float(position))
            entries += [] if entry.reason else [entry]
        drift = str(calibrate(entries).drift.state) if learns else None
        knocked = campaign.is_knocked(position)
        yield [
            replace(row, campaign=campaign.number, position=position, knock=knocked, drift=drift)
            for row in _rows(case, protocol, session)
        ]


async def _make_session(
    campaign: Campaign, case: Case, protocol: Protocol, registrar: Registrar, entries: list[CameraEntry]
) -> CampaignSession:
    """The session on `case`, given what those before found."""
    loop, finger = loop_of(protocol, registrar), campaign.finger(protocol.sensor)
    started = time.perf_counter()
    predict = partial(predict_prior, calibrate(entries)) if entries else None
    opened = await open_session(case, protocol, loop, finger, predict=predict)
    opening = time.perf_counter() - started
    return CampaignSession(
        opened, opening, tuple(await make_scans(opened, case, protocol, loop, finger, protocol.scans))
    )


def _rows(case: Case, protocol: Protocol, session: CampaignSession) -> list[Row]:
    """One for each scan, or one for the opened session if it made none."""
    prior = session.opened.estimate
    before = _row(case, protocol, session.opened, prior)
    if not session.steps:
        return [replace(before, compute_ms=1000.0 * session.opening)]
    rows = []
    for number, step in enumerate(session.steps, start=1):
        scan, seconds = step.record.scans[-1], step.seconds + (session.opening if number == 1 else 0.0)
        row = _row(case, protocol, step.record, prior)
        returns = scan.returns / scan.samples if scan.samples else None
        rows.append(replace(row, scan=number, compute_ms=1000.0 * seconds, scan_seconds=scan.duration, returns=returns))
    return rows


def _row(case: Case, protocol: Protocol, record: Record, prior: Estimate) -> Row:
    """Of a session before its first scan, but for what it has spent."""
    estimate = record.estimate
    return Row(
        mesh=case.name,
        view=case.view,
        scan=0,
        proposer=record.proposer.value,
        engine=protocol.engine.value,
        planner=protocol.planner.value,
        sensor=protocol.sensor.value,
        initial_error=case.error(Pose.identity()),
        error=case.error(estimate.base_T_correction),
        expected_error=estimate.expected_error,
        covered=case.is_covered_by(estimate),
        state=record.state.value,
        fraction=record.budget_used.fraction,
        robot_seconds=record.budget_used.seconds,
        compute_ms=0.0,
        camera=protocol.camera.value,
        scan_seconds=0.0,
        scene="alone",
        prior_error=case.error(prior.base_T_correction),
        prior_covered=case.is_covered_by(prior),
    )


def settings_of(campaign: Campaign, protocol: Protocol) -> dict[str, Any]:
    """What the runs of an evaluation depend on, besides their keys."""
    varied = {"engine", "sensor", "camera"}
    shared = {name: value for name, value in asdict(protocol).items() if name not in varied}
    meshes = [path.stem for path in campaign.meshes]
    return {"protocol": shared, "campaign": asdict(campaign.settings), "meshes": meshes}
