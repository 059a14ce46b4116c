"""`pretouch demo` end to end through the real services: on made objects, and on a frame."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from helpers.made_frame import write_frame
from PIL import Image

FIELDS = {
    "initial_error": float,
    "final_error": float,
    "expected_error": float,
    "scans": int,
    "fraction": float,
    "seconds": float,
    "state": str,
}


def demo(*options: str, timeout: float = 280) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pretouch", "demo", *options]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout)


def test_the_demo_runs_both_sessions_and_leaves_picture_and_report(tmp_path: Path) -> None:
    done = demo("--results", str(tmp_path / "results"))
    assert done.returncode == 0, done.stderr[-3000:]
    assert "drill, REST" in done.stdout
    assert "mug, gRPC" in done.stdout
    assert "times as fast as planned" in done.stdout
    assert "picture.png" in done.stdout
    with Image.open(tmp_path / "results" / "picture.png") as image:
        assert image.width > 2000
    assert "mug, gRPC" in (tmp_path / "results" / "report.html").read_text()
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("engine", ["posterior", "paper"])
def test_a_frame_is_corrected_by_either_engine(tmp_path: Path, engine: str) -> None:
    out = tmp_path / "deep" / "out.json"
    done = demo("--frame", str(write_frame(tmp_path)), "--object", "box", "--engine", engine, "--json", str(out))
    assert done.returncode == 0, done.stderr[-3000:]
    result: dict[str, Any] = json.loads(out.read_text())
    assert {name: type(value) for name, value in result.items()} == FIELDS
    assert result["state"] in ("converged", "exhausted")
    assert result["scans"] >= 1
    assert result["seconds"] > 0
    if engine == "posterior":
        assert result["final_error"] < 0.6 * result["initial_error"]


def test_what_is_wrong_is_said_in_two_lines(tmp_path: Path) -> None:
    frame = str(write_frame(tmp_path))
    for options, said in (
        (("--frame", frame, "--object", "teapot"), "Choose from: box, can."),
        (("--frame", frame), "Choose from: box, can."),
        (("--frame", str(tmp_path / "none.json"), "--object", "box"), "There is no frame"),
        (("--object", "box"), "--object and --json go with --frame"),
    ):
        done = demo(*options)
        assert done.returncode == 2
        assert said in done.stderr
        assert "Traceback" not in done.stderr
