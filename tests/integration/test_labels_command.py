"""`pretouch labels` end to end: the same files for any number of workers, after any end, and on a Ray cluster."""

import importlib.util
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from helpers.label_cases import example
from pretouch_detector.training.dataset import Dataset, write
from pretouch_simulation.labels.command import labels
from typer.testing import CliRunner

from pretouch.errors import Conflict, Malformed, Unavailable

OBJECTS = 3
HANGS = 400
"""s after which a process hangs; a busy machine that compiles kernels is slow."""
TINY = ("--kind", "trials", "--rectangles", "6", "--trials", "2", "--poses", "1", "--views", "1")


def generate(out: Path, *options: str) -> Result:
    before = signal.getsignal(signal.SIGTERM)
    try:
        return CliRunner().invoke(labels, ["generate", "--out", str(out), *TINY, *options])
    finally:
        signal.signal(signal.SIGTERM, before)


def started(out: Path, *options: str) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "pretouch", "labels", "generate", "--out", str(out), *TINY, *options]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def arrays(out: Path) -> dict[str, bytes]:
    """Every array of every view, to the bit."""
    found = {}
    for path in sorted(out.rglob("*.npz")):
        with path.open("rb") as stream, np.load(stream) as file:
            found |= {f"{path.relative_to(out)} {name}": file[name].tobytes() for name in file.files}
    return found


@pytest.fixture(scope="module")
def by_two(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Result, dict[str, bytes]]]:
    """What two workers say and make of objects made in code and of a mesh that cannot be read."""
    meshes, out = tmp_path_factory.mktemp("meshes"), tmp_path_factory.mktemp("two")
    (meshes / "broken.ply").write_text("ply\n")
    said = generate(out, "--meshes", str(meshes), "--made-in-code", str(OBJECTS), "--workers", "2")
    return said, arrays(out)


@pytest.mark.timeout(3 * HANGS)
def test_views_that_cannot_be_labelled_are_listed_and_do_not_stop_the_run(
    by_two: tuple[Result, dict[str, bytes]],
) -> None:
    said, made = by_two
    assert said.exit_code == 0, said.output
    assert (
        "broken-0-0: The header of broken.ply has no end_header. Export it as PLY 1.0, ASCII or binary." in said.output
    )
    assert f"{OBJECTS} of {OBJECTS + 1} views are labelled" in said.output
    assert len({name.split()[0] for name in made}) == OBJECTS


@pytest.mark.timeout(3 * HANGS)
def test_one_worker_ended_twice_makes_the_same_files_as_two(
    by_two: tuple[Result, dict[str, bytes]], tmp_path: Path
) -> None:
    def ended(end: signal.Signals, files: int) -> tuple[int, str]:
        with started(tmp_path, "--made-in-code", "5000", "--workers", "1") as process:
            give_up = time.monotonic() + HANGS
            while len(list(tmp_path.rglob("*.npz"))) < files and time.monotonic() < give_up:
                time.sleep(0.01)
            process.send_signal(end)
            try:
                return process.wait(HANGS), process.communicate(timeout=HANGS)[1]
            finally:
                process.kill()

    code, said = ended(signal.SIGTERM, 1)
    kept = list(tmp_path.rglob("*.npz"))
    assert code == 130, said
    assert f"{len(kept)} of 5000 views are kept" in said
    assert "the same command goes on" in said
    assert "Traceback" not in said
    assert ended(signal.SIGKILL, len(kept) + 1)[0] == -signal.SIGKILL
    made = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.npz")}
    assert len(made) > len(kept)
    (tmp_path / "train" / f".code__can_001-0-0.npz.{2**22 + 1}").write_bytes(b"half")
    done = generate(tmp_path, "--made-in-code", str(OBJECTS), "--workers", "1")
    assert done.exit_code == 0, done.output
    assert {path: path.stat().st_mtime_ns for path in made} == made
    assert {name: value for name, value in arrays(tmp_path).items() if name in by_two[1]} == by_two[1]


@pytest.mark.timeout(3 * HANGS)
@pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="no Ray here: pip install 'pretouch[ray]'")
def test_a_ray_cluster_of_two_workers_makes_the_same_files(
    by_two: tuple[Result, dict[str, bytes]], tmp_path: Path
) -> None:
    with started(tmp_path, "--made-in-code", str(OBJECTS), "--workers", "2", "--engine-cluster", "ray") as process:
        try:
            _, said = process.communicate(timeout=HANGS)
        except subprocess.TimeoutExpired:
            pytest.skip(f"Ray does not start on this machine within {HANGS} s.")
        finally:
            process.kill()
    if "Ray cannot be used" in said:
        pytest.skip(f"Ray does not start on this machine: {said[-300:]}")
    assert process.returncode == 0, said
    assert arrays(tmp_path) == by_two[1]


def test_without_ray_the_command_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    said = generate(tmp_path, "--made-in-code", "1", "--engine-cluster", "ray").exception
    assert isinstance(said, Unavailable)
    assert said.remedy == "Run: pip install 'pretouch[ray]'"


def test_a_folder_of_another_recipe_is_left_alone(tmp_path: Path) -> None:
    Dataset.create(tmp_path, {"recipe": {"kind": "scans", "seed": 3}})
    said = generate(tmp_path, "--made-in-code", "1").exception
    assert isinstance(said, Conflict)
    assert "another recipe" in said.detail
    assert [path.name for path in tmp_path.iterdir()] == ["dataset.json"]


def test_show_prints_a_table_and_draws_two_pictures_and_names_a_truncated_file(tmp_path: Path) -> None:
    dataset = Dataset.create(tmp_path / "labels", {"recipe": {"kind": "scans", "seed": 3}})
    for name in ("box-0-0", "can-0-0"):
        write(dataset.path("train", name), example(name))
    arguments = ["show", str(dataset.folder), "--out", str(tmp_path / "pictures")]
    done = CliRunner().invoke(labels, arguments)
    assert done.exit_code == 0, done.output
    assert "unscannable" in done.output
    assert sorted(path.name for path in (tmp_path / "pictures").iterdir()) == ["contact_sheet.png", "statistics.png"]
    path = dataset.path("train", "can-0-0")
    path.write_bytes(path.read_bytes()[:700])
    said = CliRunner().invoke(labels, arguments).exception
    assert isinstance(said, Malformed)
    assert f"{path} is damaged" in said.detail
    assert "Delete it" in said.remedy
