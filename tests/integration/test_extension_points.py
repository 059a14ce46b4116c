"""A proposer, an engine, a fingertip, a camera, a text format and a store are one new file and one line each.

The files and the lines are those of the READMEs, put into a copy of the packages.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import httpx
import pytest
from helpers import box_view
from helpers.extended_house import extend_house
from helpers.fake_upstream import FakeUpstream
from helpers.made_frame import write_mesh
from helpers.processes import Orchestrator
from helpers.rest_sessions import scanned
from helpers.sources import ROOT
from pretouch_simulation.objects import MAKERS


@pytest.fixture(scope="module")
def extended(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of a process that sees the extended packages, wherever it is started."""
    folders = [*extend_house(tmp_path_factory.mktemp("house")), str(ROOT / "tests")]
    return {"PYTHONPATH": os.pathsep.join(folders), "PYTHONSAFEPATH": "1"}


def run(extended: dict[str, str], *words: str) -> str:
    done = subprocess.run(
        [sys.executable, *words],
        env=os.environ | extended,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stderr[-2000:] + done.stdout[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def told(extended: dict[str, str]) -> dict[str, Any]:
    return dict(json.loads(run(extended, "-m", "helpers.extension_probe")))


def test_the_detector_proposes_by_a_new_proposer_and_rest_takes_its_name(told: dict[str, Any]) -> None:
    detector = told["detector"]
    assert (detector["proposer"], detector["regions"], detector["listed"]["middle"]) == ("middle", 1, True)
    assert '"middle"' in told["rest"]


def test_the_gateway_parses_a_new_text_format_and_recognises_it(told: dict[str, Any]) -> None:
    assert "labelled" in told["formats"]
    for answer in told["gateway"].values():
        assert answer == {"format": "labelled", "ranges": [[0.045], [0.046]]}


def test_an_evaluation_takes_a_new_camera_fingertip_proposer_and_engine_by_their_names(
    extended: dict[str, str], tmp_path: Path
) -> None:
    meshes, out = tmp_path / "meshes", tmp_path / "rows.json"
    meshes.mkdir()
    write_mesh(meshes / "mug.obj", MAKERS["mug"]())
    names = {"camera": "quiet", "sensor": "exact", "proposer": "middle", "engine": "still"}
    options = [word for name, value in names.items() for word in (f"--{name}", value)]
    run(
        extended,
        *("-m", "pretouch", "evaluate", "--meshes", str(meshes), "--views", "1", "--scans", "1", "--workers", "1"),
        *("--json", str(out), *options),
    )
    (row,) = json.loads(out.read_text())["rows"]
    assert {name: row[name] for name in names} == names
    assert row["error"] == pytest.approx(row["initial_error"])


def test_a_session_lives_in_a_new_store(extended: dict[str, str], fakes: FakeUpstream, tmp_path: Path) -> None:
    variables = extended | {"PRETOUCH_ORCHESTRATOR_STORE": f"forgetful:{tmp_path}/kept-"}
    with (
        Orchestrator(tmp_path / "unused", fakes.address, **variables) as orchestrator,
        httpx.Client(base_url=orchestrator.rest_url, timeout=60) as rest,
    ):
        session = rest.post("/v1/sessions", files=box_view.multipart()).json()
        assert len(scanned(rest, session)["scans"]) == 1
        assert list(tmp_path.glob("kept-*/sessions.sqlite"))
    assert not list(tmp_path.iterdir())


def test_a_store_of_an_unknown_kind_is_refused_by_name(fakes: FakeUpstream, tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match=r"no kind of store 'sqlight'.*KIND one of sqlite"):
        Orchestrator(tmp_path, fakes.address, PRETOUCH_ORCHESTRATOR_STORE="sqlight:x").start()
