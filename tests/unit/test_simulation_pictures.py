"""The demo's picture and report are complete, for sessions of any length."""

import json
import re
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pretouch_orchestrator.report.document import build_document
from pretouch_orchestrator.sessions.events import derive_events
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store.protocol import NewEvent
from pretouch_simulation.demo import Recording, request_for
from pretouch_simulation.demo_table import live_table
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.picture import save_picture
from pretouch_simulation.protocol import Case, make_case
from pretouch_simulation.report import save_report
from rich.console import Console

from pretouch.estimate import from_prior
from pretouch.geometry import Plane, Pose
from pretouch.prior import Prior
from pretouch.rectangle import RotatedRectangle
from pretouch.scene import Scene
from pretouch.session import BudgetUsed, Planner, Proposer, Region, ScanSummary, Session, State
from pretouch.tof import Scan, Sensor


@pytest.fixture(scope="module")
def case() -> Case:
    return make_case("drill", MAKERS["drill"](), 0)


def recorded(case: Case, scans: int) -> Recording:
    """A session that halves its error with each scan."""
    v, u = (x.mean() for x in np.nonzero(case.mask))
    regions = tuple(Region(f"region-{k}", RotatedRectangle(u, v, 40 + 9 * k, 30, 0.3 * k), 0.5, 0.01) for k in range(5))
    before = from_prior(Prior(), case.cloud)
    recording = Recording("drill, REST", case)
    for k in range(scans + 1):
        correction = Pose.of(np.eye(3), (1 - 0.5**k) * (case.truth.apply(before.centroid) - before.centroid))
        estimate = replace(before, base_T_correction=correction, modes=(), expected_error=before.expected_error / 2**k)
        summaries = tuple(
            ScanSummary(f"scan-{j}", f"region-{j}", f"region-{j}", 90, 80, 0.3, 6.0, 0.01) for j in range(k)
        )
        state = State.CONVERGED if k == scans else State.AWAITING_SCAN
        used = BudgetUsed(k, 6.0 * k, 0.07 * k)
        recording.states.append(
            Session("1", state, Proposer.RANDOM, Planner.INFORMATION, regions, estimate, None, summaries, used)
        )
        if k:
            recording.points.append(case.truth.apply(case.cloud[:: 50 * k]))
    return recording


def as_record(recording: Recording) -> Record:
    """The orchestrator's record of the session."""
    case, last = recording.case, recording.last
    return Record(
        id=last.id,
        created=0.0,
        request=request_for(case, Sensor()),
        scene=Scene(case.depth, case.camera, case.base_T_camera, case.mask, Plane(np.array([0.0, 0.0, 1.0]), 0.0)),
        origin=(0, 0),
        proposer=last.proposer,
        regions=last.regions,
        estimate=last.estimate,
        state=last.state,
        scans=last.scans,
        measured=tuple(Scan.of_points(points, [0, 0, -1]) for points in recording.points),
        budget_used=last.budget_used,
    )


def as_events(recording: Recording) -> list[NewEvent]:
    """The session's events."""
    pairs = zip([None, *recording.states], recording.states, strict=False)
    return [event for before, after in pairs for event in derive_events(before, after)]


@pytest.mark.parametrize("scans", [0, 3])
def test_the_picture_is_drawn(case: Case, tmp_path: Path, scans: int) -> None:
    save_picture([recorded(case, scans)], tmp_path / "picture.png")
    with Image.open(tmp_path / "picture.png") as image:
        assert image.width > 2000
        assert image.height > 600
        assert len(np.unique(np.asarray(image.convert("L")))) > 50


@pytest.mark.parametrize("scans", [0, 3])
def test_the_report_needs_nothing_else_and_says_the_errors(case: Case, tmp_path: Path, scans: int) -> None:
    recording = recorded(case, scans)
    recording.report = build_document(as_record(recording), as_events(recording))
    save_report([recording], "A <made> session.", tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text()
    assert not re.findall(r"<(?:script|link)[^>]+(?:src|href)=", text)
    assert "A &lt;made&gt; session." in text
    for true, expected in zip(recording.true_errors(), recording.expected_errors(), strict=True):
        assert f"<td>{1000 * true:.2f}</td>" in text
        assert f"<td>{1000 * expected:.2f}</td>" in text


def test_the_true_object_in_the_report_is_where_it_is(case: Case, tmp_path: Path) -> None:
    recording = recorded(case, 1)
    recording.report = build_document(as_record(recording), as_events(recording))
    save_report([recording], "", tmp_path / "report.html")
    found = re.search(r'"truth":(\{.*?\})', (tmp_path / "report.html").read_text())
    assert found is not None
    points = np.reshape(json.loads(found[1])["points"], (-1, 3)) * recording.report["unit"] + recording.report["origin"]
    body = case.world.bodies[0]
    vertices = body.base_T_mesh.apply(body.mesh.vertices)
    np.testing.assert_allclose(np.ptp(points, axis=0), np.ptp(vertices, axis=0), atol=0.01)
    assert (points >= vertices.min(axis=0) - 1e-4).all()
    assert (points <= vertices.max(axis=0) + 1e-4).all()


def test_the_live_table_fits_a_narrow_terminal(case: Case) -> None:
    output = StringIO()
    recording = recorded(case, 3)
    Console(file=output, width=60).print(live_table([recording, Recording("mug, gRPC", case)]))
    text = output.getvalue()
    assert "…" not in text
    assert "converged" in text
    assert "robot s" in text
    assert f"{1000 * recording.true_errors()[-1]:.1f}" in text
