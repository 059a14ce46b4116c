"""The examples of the README and of the first tutorial work as printed, against all four services."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.scenes import KINECT, Box, View, World
from PIL import Image
from pretouch_simulation.services import Services

from pretouch.geometry import Pose

pytestmark = pytest.mark.timeout(600)
ROOT = Path(__file__).resolve().parents[2]
CAMERA = Pose.from_quaternion([-0.6, 0.0, 0.6], [-0.653, 0.653, -0.271, 0.271])


def example(document: str, language: str, containing: str) -> str:
    blocks = re.findall(rf"```{language}\n(.*?)```", (ROOT / document).read_text(), re.DOTALL)
    return next(block for block in blocks if containing in block)


@pytest.fixture(scope="module")
def services() -> Iterator[Services]:
    with Services() as running:
        yield running


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with `depth.png`: a box on a table, in millimetres, from where the README's camera stands."""
    view = View(CAMERA, KINECT.camera, KINECT.width, KINECT.height)
    depth, _ = World((Box.standing((0.10, 0.07, 0.06), yaw=0.3),)).depth(view, np.random.default_rng(0))
    Image.fromarray(np.round(1000 * depth.metres).astype(np.uint16)).save(tmp_path / "depth.png")
    return tmp_path


def test_the_python_example_runs_to_an_end(services: Services, folder: Path) -> None:
    code = example("README.md", "python", "RestClient").replace("http://127.0.0.1:8080", services.rest)
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    assert re.search(r"^exhausted [\d.]+ mm expected$", done.stdout, re.MULTILINE), done.stdout
    assert "stuck" in done.stdout.splitlines()[-1]


def test_the_first_session_of_the_tutorial_ends_well(services: Services, tmp_path: Path) -> None:
    code = example("docs/tutorials/first-session.md", "python", "make_case")
    done = subprocess.run(
        [sys.executable, "-c", code.replace("http://127.0.0.1:8080", services.rest)],
        cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert re.search(r"converged +expected +[\d.]+ mm", done.stdout), done.stdout


@pytest.mark.skipif(shutil.which("curl") is None, reason="needs curl")
def test_the_curl_examples_open_a_session_and_answer_its_scan(services: Services, folder: Path) -> None:
    def call(containing: str, **names: str) -> dict[str, Any]:
        command = example("README.md", "sh", containing).replace("http://127.0.0.1:8080", services.rest)
        for name, value in names.items():
            command = command.replace(f"/{name}", f"/{value}")
        done = subprocess.run(
            ["sh", "-c", command], cwd=folder, capture_output=True, text=True, timeout=120, check=False
        )
        document: dict[str, Any] = json.loads(done.stdout)
        return document

    session = call("depth=@depth.png")
    assert session["state"] == "awaiting_scan", session
    scan = session["next_scan"]
    assert scan["waypoints"]
    answered = call("samples", SCAN_ID=scan["scan_id"], ID=session["id"])
    assert [(done["scan_id"], done["samples"]) for done in answered["scans"]] == [(scan["scan_id"], 1)]
