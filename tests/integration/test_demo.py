"""`pretouch demo` end to end through the real services: on made objects, and on a frame."""

import json
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from helpers.made_frame import write_frame
from PIL import Image

INTERRUPTIBLE = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from pretouch.__main__ import main
main()
"""
"""A shell's background job ignores SIGINT, and so would a child of such a test."""
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
        (("--results", "/proc/results"), "/proc/results cannot be written"),
        (("--frame", frame, "--object", "box", "--json", "/proc/out.json"), "/proc/out.json cannot be written"),
    ):
        done = demo(*options)
        assert done.returncode == 2
        assert said in done.stderr
        assert "Traceback" not in done.stderr


def children_of(parent: int) -> list[int]:
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            if int(stat.read_text().rpartition(")")[2].split()[1]) == parent:
                found.append(int(stat.parent.name))
    return found


def test_an_interrupt_while_the_services_start_leaves_nothing_behind(tmp_path: Path) -> None:
    command = [sys.executable, "-c", INTERRUPTIBLE, "demo", "--results", str(tmp_path / "results")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        started: list[int] = []
        for _ in range(2400):
            started = children_of(process.pid)
            if len(started) >= 3 or process.poll() is not None:  # two fingers and the services
                break
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=120)
    assert (process.returncode, said) == (130, "Interrupted.\n")
    assert len(started) >= 3
    assert not any(Path(f"/proc/{pid}").exists() for pid in started)
    assert list((tmp_path / "results").iterdir()) == []
