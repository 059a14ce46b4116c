"""A process that records may be killed at any moment, told to end, or starved of disk."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path
from random import Random

import pytest
from helpers.gateway_recordings import files_in, sequence_in

from pretouch.recording.reader import RecordingReader

TESTS = Path(__file__).parents[1]
TIMEOUT = 60.0


def started(mode: str, folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "helpers.gateway_recording_child", mode, str(folder)],
        cwd=TESTS,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        text=True,
    )


@pytest.mark.parametrize("seed", range(6))
def test_kill_9_loses_nothing_that_was_recorded(tmp_path: Path, seed: int) -> None:
    lines = Random(seed).randrange(1, 2000)
    with started("loop", tmp_path) as process:
        assert process.stdout is not None
        said = [process.stdout.readline() for _ in range(lines)]
        process.kill()
        said += [line for line in process.stdout if line.endswith("\n")]
    assert process.returncode == -signal.SIGKILL
    given, recorded, unrecorded = map(int, said[-1].split())
    assert unrecorded == 0
    readers = [RecordingReader(path) for path in files_in(tmp_path)]
    for reader in readers:
        list(reader)
    assert all(reader.complete for reader in readers[:-1])
    found = [number for path in files_in(tmp_path) for number in sequence_in(path)]
    assert found == list(range(len(found)))
    assert recorded <= len(found) <= given + 1


def test_sigterm_finishes_the_file(tmp_path: Path) -> None:
    with started("serve", tmp_path) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "recording\n"
        process.terminate()
        said, errors = process.communicate(timeout=TIMEOUT)
    assert (process.returncode, errors) == (0, "")
    status = json.loads(said)
    (path,) = files_in(tmp_path)
    reader = RecordingReader(path)
    list(reader)
    assert (reader.complete, reader.torn_bytes) == (True, 0)
    assert sequence_in(path) == list(range(status["given"]))
    assert (status["measurements"], status["unrecorded"], status["pending"]) == (status["given"], 0, 0)


def test_a_limit_on_the_size_of_files_pauses_and_recording_goes_on_without_it(tmp_path: Path) -> None:
    with started("starve", tmp_path) as process:
        said, errors = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 0, errors
    status = json.loads(said)
    assert status["given"] == status["measurements"] + status["unrecorded"] == 2000
    assert 800 <= status["measurements"] < 2000
    assert any("File too large" in problem for problem in status["problems"])
    assert status["problems"][-1] == ""
    paths = files_in(tmp_path)
    found = [number for path in paths for number in sequence_in(path)]
    assert found == sorted(set(found))
    assert len(found) == status["measurements"]
    assert found[-1] == 1999
    assert errors.count("recording is paused") == errors.count("recording goes on") > 0
    readers = [RecordingReader(path) for path in paths]
    for reader in readers:
        list(reader)
    assert [reader.torn_bytes for reader in readers] == [0] * len(readers)  # what was torn was cut away
