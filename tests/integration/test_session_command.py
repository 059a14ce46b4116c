"""`pretouch session` against a real orchestrator before fake services, and `watch` in a real terminal."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import httpx
import numpy as np
import pytest
from helpers.processes import Orchestrator
from helpers.rest_sessions import opened, scanned
from helpers.scripted_orchestrator import ScriptedOrchestrator
from helpers.terminals import Terminal

from pretouch.cli import main
from pretouch.errors import NotFound
from pretouch.estimate import from_prior
from pretouch.prior import Prior
from pretouch.session import Planner, Proposer, Session, State


class Done(NamedTuple):
    """What a command answered."""

    code: object
    out: str
    err: str


Command = Callable[..., Done]


@pytest.fixture
def command(orchestrator: Orchestrator, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Runs `pretouch session` at the orchestrator, or at `url`."""
    monkeypatch.delenv("COLUMNS", raising=False)

    def run(*arguments: str, url: str = orchestrator.rest_url) -> Done:
        monkeypatch.setattr(sys, "argv", ["pretouch", "session", *arguments, "--url", url])
        capsys.readouterr()
        with pytest.raises(SystemExit) as ending:
            main()
        return Done(ending.value.code, *capsys.readouterr())

    return run


def refused(done: Done, code: int) -> str:
    """The two lines of an error."""
    assert (done.code, done.out) == (code, "")
    assert len(done.err.strip().splitlines()) == 2
    return done.err


def test_sessions_are_listed_page_by_page_the_newest_first(
    command: Command, rest: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pretouch.session_command.overview._PAGE", 2)
    newest = [opened(rest)["id"] for _ in range(5)][::-1]
    done = command("list", "--limit", "3")
    assert done.code == 0
    lines = done.out.splitlines()
    assert [line.split()[:2] for line in lines[2:5]] == [[name, "awaiting_scan"] for name in newest[:3]]
    assert lines[5:] == ["The newest 3 are shown; --limit shows more."]
    document = json.loads(command("list", "--limit", "5", "--json", "-").out)
    assert [session["id"] for session in document["sessions"]] == newest


def test_an_ended_session_is_shown_and_followed_from_its_start(
    command: Command, rest: httpx.Client, tmp_path: Path
) -> None:
    session = opened(rest)
    while session["next_scan"]:
        session = scanned(rest, session)
    shown, followed = command("show", session["id"]), command("watch", session["id"], "--json", "-")
    (first, *_), told = shown.out.splitlines(), followed.err.splitlines()
    assert first == f"Session {session['id']} has converged after 3 scans: its tolerance is met."
    assert first in told
    assert [line.split()[0] for line in told if " returned, " in line] == ["scan-1", "scan-2", "scan-3"]
    assert json.loads(followed.out) == session
    path = tmp_path / "session.json"
    assert command("show", session["id"], "--json", str(path)).out == shown.out
    assert json.loads(path.read_text()) == session


def test_cancelling_and_removing_say_what_they_did(command: Command, rest: httpx.Client) -> None:
    name = opened(rest)["id"]
    assert command("cancel", name).out == f"Session {name} is cancelled, after no scan.\n"
    assert rest.get(f"/v1/sessions/{name}").json()["state"] == "cancelled"
    assert "stays as it is" in command("cancel", name).out
    assert "was cancelled after no scan" in command("show", name).out
    assert f"Session {name} is removed" in command("purge", name).out
    for each in ("show", "watch", "cancel", "purge", "report"):
        assert f"no session '{name}'" in refused(command(each, name), 2)


def test_a_report_becomes_a_file(command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    ended = Session("s1", State.CONVERGED, Proposer.RANDOM, Planner.INFORMATION, (), from_prior(Prior(), np.eye(3)))
    with ScriptedOrchestrator(ended) as script:
        script.errors = [b"<p>1", b"<p>2", NotFound("There is no page.", "Look.")]
        assert command("report", "s1", url=script.rest_url).out == "session-s1.html: 0.00 MB.\n"
        assert (tmp_path / "session-s1.html").read_text() == "<p>1"
        assert command("report", "s1", "--out", "-", url=script.rest_url).out == "<p>2"
        assert "makes no reports" in refused(command("report", "s1", url=script.rest_url), 1)
    assert "cannot be written" in refused(command("report", "s1", "--out", str(tmp_path)), 2)
    assert (tmp_path / "session-s1.html").read_text() == "<p>1"


def test_watching_outlives_a_restart_and_ends_with_the_session(orchestrator: Orchestrator, rest: httpx.Client) -> None:
    session = opened(rest)
    with Terminal("session", "watch", session["id"], "--url", orchestrator.rest_url) as terminal:
        terminal.wait_for("next: scan-1")
        session = scanned(rest, session)
        terminal.wait_for("next: scan-2")
        orchestrator.kill()
        orchestrator.start()
        while session["next_scan"]:
            session = scanned(rest, session)
        assert terminal.ended() == 0
        screen = terminal.screen
    assert sum("scan-1 along" in line and "next" not in line for line in screen) == 1
    assert any("has converged after 3 scans" in line for line in screen)


def test_ctrl_c_ends_watching_but_not_the_session(orchestrator: Orchestrator, rest: httpx.Client) -> None:
    session = opened(rest)
    with Terminal("session", "watch", session["id"], "--url", orchestrator.rest_url) as terminal:
        terminal.wait_for("next: scan-1")
        terminal.type(b"\x03")
        assert terminal.ended() == 130
        assert "Interrupted." in "\n".join(terminal.screen)
        assert b"Traceback" not in terminal.said
    assert rest.get(f"/v1/sessions/{session['id']}").json()["state"] == "awaiting_scan"
