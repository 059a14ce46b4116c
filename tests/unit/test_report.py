"""A session's report: bounded, finite, complete in every state, and closed to markup in names."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Sequence
from dataclasses import replace
from hashlib import sha256
from typing import Any

import numpy as np
import pytest
from helpers.loop_fakes import FormulaRegistrar, RandomDetector, answer, asked, misses, opened, samples_of
from helpers.records import a_record, after_a_scan
from pretouch_orchestrator.report.document import build_document
from pretouch_orchestrator.report.page import content_security_policy, render_page
from pretouch_orchestrator.sessions.events import derive_events
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store.protocol import NewEvent

from pretouch.calibrated_camera import (
    CalibratedCamera,
    CalibrationDrift,
    CalibrationResidual,
    CameraSession,
)
from pretouch.camera import Camera, DepthImage
from pretouch.exhaustion import Exhaustion
from pretouch.geometry import Pose
from pretouch.scene import Scene
from pretouch.session import Budget, ScanSummary, State, Tolerance
from pretouch.session_warning import SessionWarning
from pretouch.tof import MAX_SAMPLES, Scan

HOSTILE = "</script><img src=x onerror=alert(1)>\"'&\u2028<!--"


def session(**changes: Any) -> tuple[Record, list[NewEvent]]:
    """A session at its end, and its events."""
    loop = Loop(RandomDetector(), FormulaRegistrar())
    record = opened(loop, asked(**changes))
    events = derive_events(None, record.to_session())
    while record.next_scan is not None:
        before, record = record, answer(loop, record, samples_of(record))
        events += derive_events(before.to_session(), record.to_session())
    return record, events


def strict_json(document: dict[str, Any]) -> str:
    return json.dumps(document, allow_nan=False)


def blocks(page: str, kind: str) -> list[str]:
    return re.findall(rf'<script type="{kind}">(.*?)</script>', page, flags=re.DOTALL)


def test_the_document_tells_the_session_scan_by_scan() -> None:
    record, events = session(tolerance=Tolerance(0.0005), budget=Budget(scans=3, fraction=1.0))
    document = build_document(record, events)
    strict_json(document)
    assert record.state is State.EXHAUSTED
    assert record.reason is not None
    assert record.reason["detail"] in document["outcome"]
    assert record.reason["remedy"] in document["outcome"]
    assert [scan["returns"] for scan in document["scans"]] == [scan.returns for scan in record.scans]
    errors = [estimate["expected_error"] for estimate in document["estimates"]]
    assert errors[1:] == [scan.expected_error for scan in record.scans]
    assert errors == sorted(errors, reverse=True)
    assert document["estimates"][0]["turn"] == np.eye(3).ravel().tolist()
    hits = np.reshape(document["scans"][0]["hits"], (-1, 3)) * document["unit"] + document["origin"]
    np.testing.assert_allclose(hits, record.measured[0].points(), atol=1e-4)


def test_the_last_estimate_corrects_the_cloud_as_the_session_does() -> None:
    record, events = session()
    document = build_document(record, events)
    cloud = np.reshape(document["cloud"], (-1, 3)) * document["unit"]
    last = document["estimates"][-1]
    corrected = cloud @ np.reshape(last["turn"], (3, 3)).T + last["shift"] + document["origin"]
    expected = record.estimate.base_T_correction.apply(cloud + document["origin"])
    np.testing.assert_allclose(corrected, expected, atol=1e-6)


def test_residuals_are_small_after_the_right_correction_and_tell_a_wrong_one() -> None:
    record, events = session()
    right = build_document(record, events)["scans"][0]["residuals"]
    moved = replace(record, estimate=opened(Loop(RandomDetector(), FormulaRegistrar()), asked()).estimate)
    wrong = build_document(moved, events)["scans"][0]["residuals"]
    assert abs(right[2]) < 0.001
    assert abs(wrong[2]) > 0.005


@pytest.mark.parametrize("state", [State.FAILED, State.CANCELLED, State.AWAITING_SCAN])
def test_every_state_has_a_report_without_a_scan_too(state: State) -> None:
    failed = after_a_scan(a_record())
    record = a_record() if state is not State.FAILED else failed
    record = replace(record, state=state)
    document = build_document(record, ())
    page = render_page("x", "", [("x", document)])
    strict_json(document)
    assert len(document["estimates"]) == len(record.scans) + 1
    assert document["outcome"].split()[0] in ("Failed", "Cancelled", "Under")
    assert "stuck" in page, "the sensor's problem"


def test_samples_that_fit_badly_are_said_however_small_the_expected_error() -> None:
    record, events = session()
    bad = replace(record, estimate=replace(record.estimate, fit=1e-4))
    assert "do not fit" in build_document(bad, events)["outcome"]
    assert "do not fit" not in build_document(record, events)["outcome"]


def test_a_scan_of_misses_alone_has_no_residuals() -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar())
    record = answer(loop, opened(loop, asked()), misses(9))
    document = build_document(record, ())
    assert document["scans"][0]["residuals"] == []
    assert len(document["scans"][0]["misses"]) == 27


@pytest.mark.parametrize(("scans", "samples"), [(20, MAX_SAMPLES), (1000, 40)])
def test_the_largest_sessions_stay_below_three_megabytes(scans: int, samples: int) -> None:
    rng = np.random.default_rng(0)
    record, events = session()
    size = (1000, 1000)
    depth = DepthImage(rng.uniform(0.4, 0.9, size).astype(np.float32))
    camera = Camera(record.request.camera.fx, record.request.camera.fy, 500.0, 500.0)
    scene = Scene(depth, camera, record.scene.base_T_camera, rng.random(size) < 0.9, record.scene.table)
    beams = Scan(
        rng.uniform(-1, 1, (samples, 3)),
        np.tile([0.0, 0, -1], (samples, 1)),
        np.where(rng.random(samples) < 0.2, np.nan, 0.05),
    )
    summary = replace(record.scans[0], samples=samples)
    record = replace(record, scene=scene, scans=(summary,) * scans, measured=(beams,) * scans)
    estimate = next(event for event in events if event.type == "estimate")
    page = render_page("x", "", [("x", build_document(record, [*[NewEvent("scan", {}), estimate] * scans]))])
    assert len(page.encode()) < 3_000_000


def hostile_record() -> Record:
    record, _ = session()
    summary = replace(record.scans[0], path_id=HOSTILE, scan_id=HOSTILE)
    return replace(
        record,
        id=HOSTILE,
        regions=tuple(replace(region, id=HOSTILE) for region in record.regions),
        scans=(summary,),
        measured=record.measured[:1],
        state=State.EXHAUSTED,
        reason={"type": Exhaustion.MISFIT.value, "detail": HOSTILE, "remedy": HOSTILE},
        warnings=(SessionWarning(HOSTILE, HOSTILE, HOSTILE),),
    )


def test_markup_in_names_stays_text() -> None:
    document = build_document(hostile_record(), ())
    page = render_page(HOSTILE, HOSTILE, [(HOSTILE, document), (HOSTILE, document)])
    assert "<img src=x" not in page
    assert "<!--" not in page
    assert "\u2028" not in "".join(blocks(page, "application/json"))
    assert page.count("</script>") == 3, "two documents and the one script"
    assert [json.loads(block)["id"] for block in blocks(page, "application/json")] == [HOSTILE, HOSTILE]


def test_the_policy_allows_the_pages_own_script_and_style_and_nothing_else() -> None:
    record, events = session()
    page = render_page("x", "", [("x", build_document(record, events))])

    def digest(text: str) -> str:
        return base64.b64encode(sha256(text.encode()).digest()).decode()

    policy = content_security_policy()
    (script,) = blocks(page, "module")
    (style,) = re.findall("<style>(.*?)</style>", page, flags=re.DOTALL)
    assert f"script-src 'sha256-{digest(script)}'" in policy
    assert f"style-src 'sha256-{digest(style)}'" in policy
    assert "unsafe" not in policy
    assert not re.findall(r"<[^>]+\s(?:style|on\w+)=", page), "they would be refused"
    assert not re.findall(r"(?:src|href)=[\"'](?!data:)", page)


@pytest.mark.parametrize(
    ("state", "since", "words"),
    [
        ("steady", None, "Known from 2 sessions; no sign that it was moved."),
        ("suspected", "s2", "Known from 2 sessions; session s2 contradicts those before it."),
        ("moved", "s2", "Known from 2 sessions; it was moved before session s2"),
    ],
)
def test_its_camera_is_shown_with_whether_it_was_moved(state: Any, since: str | None, words: str) -> None:
    record, events = session()
    history = tuple(CameraSession(f"s{k}", 60.0 * k, 0.01, 0.002) for k in (1, 2))
    camera = CalibratedCamera(
        "head",
        2,
        *[Pose.identity()] * 3,
        np.eye(12),
        CalibrationResidual(0.002, 0.007),
        CalibrationDrift(state, since),
        history=history,
    )
    document = build_document(record, events, camera)
    assert [each["session"] for each in document["camera"]["history"]] == ["s1", "s2"]
    page = render_page("x", "", [("x", document)])
    assert "Camera head, session by session" in page
    assert words in page


def test_a_truth_beside_it_is_in_the_table() -> None:
    record, events = session()
    document = build_document(record, events)
    errors = [0.0123 / (k + 1) for k in range(len(document["estimates"]))]
    page = render_page("x", "", [("x", document | {"truth": {"errors": errors}})])
    for error in errors:
        assert f"<td>{1000 * error:.2f}</td>" in page


def test_what_the_scans_are_called_is_in_the_tables() -> None:
    record, events = session()
    page = render_page("x", "", [("x", build_document(record, events))])
    names: Sequence[ScanSummary] = record.scans
    assert all(f"<td>{scan.path_id}</td>" in page for scan in names)
