"""`pretouch camera` against a real orchestrator before fake services."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from helpers.box_session import DEPTH, MASK, ROOMY, measured, request
from helpers.processes import Orchestrator
from pretouch_orchestrator.rest import camera_examples
from rich.console import Console

from pretouch.calibrated_camera import CalibrationDrift, CameraSession
from pretouch.camera_command.views import describe, draw_history
from pretouch.cli import main
from pretouch.client import RestClient
from pretouch.session import Budget
from pretouch.wire.json import camera_from_json


class Done(NamedTuple):
    """What a command answered."""

    code: object
    out: str
    err: str


Command = Callable[..., Done]


@pytest.fixture
def command(orchestrator: Orchestrator, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Runs `pretouch camera` at the orchestrator."""
    monkeypatch.delenv("COLUMNS", raising=False)

    def run(*arguments: str) -> Done:
        monkeypatch.setattr(sys, "argv", ["pretouch", "camera", *arguments, "--url", orchestrator.rest_url])
        capsys.readouterr()
        with pytest.raises(SystemExit) as ending:
            main()
        return Done(ending.value.code, *capsys.readouterr())

    return run


def test_a_camera_from_its_first_session_until_it_is_forgotten(
    command: Command, orchestrator: Orchestrator, tmp_path: Path
) -> None:
    assert "No session has named a camera yet" in command("list").out
    with RestClient(orchestrator.rest_url) as client:
        session = client.create_session(request(camera_id="head", budget=Budget(**ROOMY)), DEPTH, MASK)
        early = command("show", "head")
        assert "nothing is known" in early.out
        refused = command("export", "head")
        assert (refused.code, refused.out) == (2, "")
        while session.next_scan is not None:
            session = client.submit(session.id, session.next_scan.scan_id, measured(session.next_scan))
        at_once = client.create_session(request(camera_id="head"), DEPTH, MASK)
        client.cancel(at_once.id)
    listed = command("list")
    assert [line.split()[:3] for line in listed.out.splitlines()[2:]] == [["head", "1", "steady"]]
    shown = command("show", "head")
    assert shown.code == 0
    for word in ("after 1 session", session.id, "█", at_once.id, "It was cancelled."):
        assert word in shown.out
    document = json.loads(command("show", "head", "--json", "-").out)
    assert [each["session"] for each in document["history"]] == [session.id]
    assert json.loads(command("list", "--json", "-").out)["cameras"][0]["id"] == "head"
    assert command("export", "head").out.startswith("#")
    target = tmp_path / "head.urdf"
    assert command("export", "head", "--format", "urdf", "--out", str(target)).code == 0
    assert "<origin xyz=" in target.read_text()
    assert "is forgotten" in command("forget", "head").out
    for gone in (command("show", "head"), command("forget", "head"), command("export", "head")):
        assert (gone.code, gone.out) == (2, "")
        assert len(gone.err.strip().splitlines()) == 2


@pytest.mark.parametrize("width", [30, 80, 200])
def test_the_picture_marks_the_session_that_found_the_camera_moved(width: int) -> None:
    camera = camera_from_json(camera_examples.CAMERA)
    history = tuple(CameraSession(f"s{k:02}", 1.7e9 + 60 * k, 0.01 + 0.02 * (k > 40), 0.002) for k in range(45))
    moved = replace(camera, history=history, drift=CalibrationDrift("moved", "s41"))
    console = Console(width=width, record=True, color_system=None, markup=False)
    console.print(draw_history(moved, width))
    lines = console.export_text().splitlines()
    if width >= 80:
        bars = {line.split()[2]: line.count("█") for line in lines if line.count("█")}
        assert list(bars) == [f"s{k:02}" for k in range(15, 45)], "the newest"
        assert bars["s44"] == pytest.approx(3 * bars["s20"], abs=2)
        assert [line.split()[2] for line in lines if "◀" in line] == ["s41"]
    assert "It has moved: session s41" in "".join(map(str, describe(moved)))


def test_a_clock_of_nowhere_is_shown_as_it_is() -> None:
    camera = replace(camera_from_json(camera_examples.CAMERA), history=(CameraSession("s", 1e300, 0.0, np.inf),))
    console = Console(width=80, record=True, color_system=None)
    console.print(draw_history(camera, 80))
    assert "1e+300" in console.export_text()
