"""What `pretouch session` says of sessions that ended in every way, and that nothing in a name steers the terminal."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console, RenderableType

from pretouch.errors import Internal, problem
from pretouch.estimate import Mode, WeakDirection, from_prior
from pretouch.exhaustion import Exhaustion, exhaustion_problem
from pretouch.geometry import Pose
from pretouch.prior import Prior
from pretouch.session import Planner, Proposer, ScanPlan, ScanSummary, Session, State
from pretouch.session_command.ending import describe_cancellation, describe_purge
from pretouch.session_command.options import open_console, print_paragraphs
from pretouch.session_command.tables import tabulate_scans, tabulate_sessions
from pretouch.session_command.watch import describe_change
from pretouch.session_command.wording import clean, describe, describe_warning
from pretouch.session_warning import SessionWarning
from pretouch.trajectory import Trajectory

PLAN = ScanPlan("scan-2", "line-1", None, Trajectory(np.arange(2.0), np.tile(np.eye(4), (2, 1, 1))), 0.95)
SCAN = ScanSummary("scan-1", "region-1", "region-1", 40, 30, 0.1, 2.0, 0.0062)
NEW = Session(
    id="78a55bef6144c6e4",
    state=State.AWAITING_SCAN,
    proposer=Proposer.RANDOM,
    planner=Planner.INFORMATION,
    regions=(),
    estimate=from_prior(Prior(), np.eye(3)),
    next_scan=replace(PLAN, scan_id="scan-1"),
)
ESTIMATE = replace(
    from_prior(Prior(), np.eye(3)),
    base_T_correction=Pose.of(np.eye(3), np.array([0.01, -0.005, 0.004])),
    modes=(),
    expected_error=0.0012,
    error_quantile=0.0024,
    inliers=28,
    samples=30,
    unobservable=(WeakDirection(np.eye(6)[0], 0.004, "rotation about the vertical through the object (±4.0 deg)"),),
)
SCANNED = replace(NEW, estimate=ESTIMATE, scans=(SCAN,), next_scan=PLAN)
WARNING = SessionWarning("far-table", "The table is [bold]far[/].", "Move it.")


def ended(state: State, reason: dict[str, Any] | None = None) -> Session:
    return replace(SCANNED, state=state, next_scan=None, reason=reason)


def exhausted(cause: Exhaustion) -> Session:
    return ended(State.EXHAUSTED, exhaustion_problem(cause, "All is spent.", "Give more."))


def said(session: Session) -> str:
    return " ".join(text.plain for text in describe(session))


def printed(renderable: RenderableType, width: int) -> list[str]:
    console = Console(width=width, file=io.StringIO(), record=True)
    console.print(renderable)
    return [line.rstrip() for line in console.export_text().splitlines()]


@pytest.mark.parametrize(
    ("session", "first"),
    [
        (NEW, "Session 78a55bef6144c6e4 awaits its first scan."),
        (SCANNED, "Session 78a55bef6144c6e4 awaits another scan, after 1 scan."),
        (ended(State.CONVERGED), "Session 78a55bef6144c6e4 has converged after 1 scan: its tolerance is met."),
        (
            exhausted(Exhaustion.SCANS),
            "Session 78a55bef6144c6e4 is exhausted after 1 scan: its tolerance is not met. All is spent. Give more.",
        ),
        (
            ended(State.FAILED, problem(Internal("It broke.", "Report it."))),
            "Session 78a55bef6144c6e4 has failed after 1 scan. It broke. Report it.",
        ),
        (replace(NEW, state=State.CANCELLED), "Session 78a55bef6144c6e4 was cancelled after no scan."),
    ],
)
def test_the_first_paragraph_says_what_came_of_it_and_why(session: Session, first: str) -> None:
    assert next(describe(session)).plain == first


def test_how_certain_the_answer_is_and_what_it_says() -> None:
    text = said(ended(State.CONVERGED))
    assert "expected to be 1.2 mm, and is at most 2.4 mm with 95 % confidence" in text
    assert "tell least about: rotation about the vertical through the object (±4.0 deg)." in text
    assert "by (10.0, -5.0, 4.0) mm in base and turns it by 0.0 deg; 28 of 30 samples agree" in text
    modes = (Mode(ESTIMATE.base_T_correction, 0.7), Mode(Pose.identity(), 0.3))
    two = replace(SCANNED, estimate=replace(ESTIMATE, modes=modes))
    assert "2 different poses explain the samples; this one has a probability of 70 %." in said(two)
    assert "probability" not in text


def test_before_the_first_scan_nothing_is_said_of_samples() -> None:
    assert "sample" not in said(NEW)


@pytest.mark.parametrize("cause", Exhaustion)
def test_an_estimate_that_explains_nothing_is_not_told_as_if_it_did(cause: Exhaustion) -> None:
    text = said(exhausted(cause))
    useless = cause in (Exhaustion.MISFIT, Exhaustion.SENSOR)
    assert ("not to be used" in text) == useless
    assert ("95 % confidence" in text) != useless


@given(st.text())
def test_no_text_steers_the_terminal(text: str) -> None:
    assert clean(text).isprintable()
    assert clean(clean(text)) == clean(text)


def test_markup_and_control_characters_are_shown_as_they_are(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("COLUMNS", "FORCE_COLOR", "TTY_COMPATIBLE"):
        monkeypatch.delenv(name, raising=False)
    name = "[bold red]x[/] :boom: \x1b[31m\n\x07"
    shown = "[bold red]x[/] :boom: \ufffd[31m"
    reason = {"type": "[b]", "detail": name, "remedy": name}
    estimate = replace(ESTIMATE, unobservable=(WeakDirection(np.eye(6)[0], 0.004, name),))
    session = replace(
        ended(State.FAILED, reason), id=name, estimate=estimate, scans=(replace(SCAN, scan_id=name, path_id=name),)
    )
    console = open_console()
    print_paragraphs(console, [*describe(session), describe_warning(SessionWarning(name, name, name))])
    console.print(tabulate_scans(session.scans, 160))
    console.print(tabulate_sessions([session], 160, header=True))
    console.print(describe_purge(session))
    out = capsys.readouterr().out
    assert out.count(shown) == 11
    assert "\x1b" not in out
    assert "\x07" not in out


@pytest.mark.parametrize("width", [20, 30, 40, 60, 80, 160])
def test_tables_keep_to_the_terminal_and_the_id_stays_whole(width: int) -> None:
    sessions = [ended(State.CONVERGED), exhausted(Exhaustion.NOTHING_TO_GAIN), NEW]
    first = printed(tabulate_sessions(sessions[:1], width, header=True), width)
    others = printed(tabulate_sessions(sessions[1:], width, header=False), width)
    assert len(first) == 3
    assert len(others) == 2
    assert all(line.startswith(NEW.id) for line in (first[2], *others))
    assert ("nothing-to-gain" in others[0]) == (width >= 80)
    assert len(printed(tabulate_scans([SCAN], width), width)) == 3


def test_pages_below_each_other_are_one_table() -> None:
    pages = [exhausted(Exhaustion.NOTHING_TO_GAIN)], [ended(State.CONVERGED)], [NEW]
    lines = [printed(tabulate_sessions(page, 160, header=True), 160) for page in pages]
    assert lines[0][:2] == lines[1][:2] == lines[2][:2]


def test_a_follower_is_told_what_is_new_and_nothing_twice() -> None:
    def told(before: Session | None, now: Session) -> list[str]:
        return [text.plain for text in describe_change(before, now)]

    warned = replace(SCANNED, warnings=(WARNING,))
    first, second = "next: scan-1 along line-1", "next: scan-2 along line-1"
    assert [line[: len(first)] for line in told(None, NEW)[1:]] == [first]
    scan = "scan-1 along region-1: 40 samples, 75 % returned, 2.0 s; 6.2 mm expected"
    warning, made, planned = told(NEW, warned)
    assert warning == "Warning far-table: The table is [bold]far[/]. Move it."
    assert made == scan
    assert planned.startswith(second)
    assert told(warned, warned) == []
    assert told(warned, replace(warned, state=State.CANCELLED, next_scan=None)) == []
    assert scan in told(None, warned)


def test_cancelling_and_removing_say_what_they_did() -> None:
    done, cancelled = ended(State.CONVERGED), ended(State.CANCELLED)
    assert "is cancelled, after 1 scan." in describe_cancellation(SCANNED, cancelled)
    assert "had ended already and stays as it is. It has converged" in describe_cancellation(done, done)
    assert "ended by itself before it was cancelled. It has converged" in describe_cancellation(SCANNED, done)
    assert "It has converged after 1 scan" in describe_purge(done)
    assert "It was running, after no scan." in describe_purge(NEW)
