"""`pretouch labels` end to end: the same files for any number of workers, after any end, and on a Ray cluster."""

import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from label_cases import example
from pretouch_detector.training.dataset import Dataset, write

OBJECTS = 3
TINY = ("--kind", "trials", "--rectangles", "6", "--trials", "2", "--poses", "1", "--views", "1")


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "pretouch", "labels", *arguments]


def generate(out: Path, *options: str, expected: int = 0, environment: dict[str, str] | None = None) -> str:
    done = subprocess.run(
        command("generate", "--out", str(out), *TINY, *options),
        capture_output=True,
        text=True,
        timeout=240,
        env={**os.environ, **(environment or {})},
    )
    assert done.returncode == expected, done.stderr[-2000:] + done.stdout[-2000:]
    assert "Traceback" not in done.stderr
    return done.stdout + done.stderr


def arrays(out: Path) -> dict[str, bytes]:
    """Every array of every view, to the bit."""
    found = {}
    for path in sorted(out.rglob("*.npz")):
        with path.open("rb") as stream, np.load(stream) as file:
            found |= {f"{path.relative_to(out)} {name}": file[name].tobytes() for name in file.files}
    return found


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """By one worker."""
    out = tmp_path_factory.mktemp("one")
    said = generate(out, "--made-in-code", str(OBJECTS), "--workers", "1")
    assert f"{OBJECTS} of {OBJECTS} views are labelled" in said
    return arrays(out)


def test_two_workers_make_the_same_files(reference: dict[str, bytes], tmp_path: Path) -> None:
    generate(tmp_path, "--made-in-code", str(OBJECTS), "--workers", "2")
    assert arrays(tmp_path) == reference


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
def test_a_run_that_was_ended_goes_on_to_the_same_files(
    reference: dict[str, bytes], tmp_path: Path, end: signal.Signals
) -> None:
    endless = command("generate", "--out", str(tmp_path), *TINY, "--made-in-code", "5000", "--workers", "1")
    with subprocess.Popen(endless, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        give_up = time.monotonic() + 120
        while not arrays(tmp_path) and time.monotonic() < give_up:
            time.sleep(0.01)
        process.send_signal(end)
        try:
            _, said = process.communicate(timeout=120)
        finally:
            process.kill()
    kept = list(tmp_path.rglob("*.npz"))
    assert kept
    if end is signal.SIGTERM:
        assert process.returncode == 130, said
        assert f"{len(kept)} of 5000 views are kept" in said
    made = {path: path.stat().st_mtime_ns for path in kept}
    (tmp_path / "train" / ".code__can_001-0-0.npz.77").write_bytes(b"half")
    generate(tmp_path, "--made-in-code", str(OBJECTS), "--workers", "1")
    assert {path: path.stat().st_mtime_ns for path in kept} == made
    assert {name: value for name, value in arrays(tmp_path).items() if name in reference} == reference


@pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="Ray is not installed: pip install 'pretouch[ray]'")
def test_a_ray_cluster_of_two_workers_makes_the_same_files(reference: dict[str, bytes], tmp_path: Path) -> None:
    options = ("--made-in-code", str(OBJECTS), "--workers", "2", "--engine-cluster", "ray")
    try:
        done = subprocess.run(
            command("generate", "--out", str(tmp_path), *TINY, *options), capture_output=True, text=True, timeout=200
        )
    except subprocess.TimeoutExpired:
        pytest.skip("Ray does not start on this machine within 200 s.")
    if "Ray cannot be used" in done.stderr:
        pytest.skip(f"Ray does not start on this machine: {done.stderr[-300:]}")
    assert done.returncode == 0, done.stderr[-2000:]
    assert arrays(tmp_path) == reference


def test_without_ray_the_command_says_what_to_install(tmp_path: Path) -> None:
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "ray.py").write_text("raise ImportError('absent')\n")
    said = generate(
        tmp_path / "out", "--made-in-code", "1", "--engine-cluster", "ray",
        expected=2, environment={"PYTHONPATH": str(tmp_path / "site")},
    )  # fmt: skip
    assert "Ray is not installed." in said
    assert "pip install 'pretouch[ray]'" in said


def test_views_that_cannot_be_labelled_are_listed_and_do_not_stop_the_run(tmp_path: Path) -> None:
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    (meshes / "broken.ply").write_text("ply\n")
    out = tmp_path / "out"
    said = generate(out, "--meshes", str(meshes), "--made-in-code", "1", "--workers", "1")
    assert "broken-0-0: broken.ply holds no triangles. Export it as a triangle mesh." in said
    assert "1 of 2 views are labelled" in said
    said = generate(out, "--meshes", str(meshes), "--workers", "1", expected=1)
    assert "0 of 1 views are labelled" in said
    said = generate(out, "--made-in-code", "1", "--seed", "1", expected=2)
    assert "made with another recipe" in said


def test_show_prints_a_table_and_draws_two_pictures_and_names_a_truncated_file(tmp_path: Path) -> None:
    dataset = Dataset.create(tmp_path / "labels", {"recipe": {"kind": "scans", "seed": 3}})
    for name in ("box-0-0", "can-0-0"):
        write(dataset.path("train", name), example(name))
    shown = command("show", str(dataset.folder), "--out", str(tmp_path / "pictures"))
    done = subprocess.run(shown, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "unscannable" in done.stdout
    assert sorted(path.name for path in (tmp_path / "pictures").iterdir()) == ["contact_sheet.png", "statistics.png"]
    path = dataset.path("train", "can-0-0")
    path.write_bytes(path.read_bytes()[:700])
    done = subprocess.run(shown, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert "can-0-0.npz is damaged" in done.stderr
    assert "Delete it" in done.stderr
    assert "Traceback" not in done.stderr
