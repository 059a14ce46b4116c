"""A replayed session: the recorded numbers to the bit, and what other settings would have answered."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.session_recordings import recorded_session
from pretouch_orchestrator.recording.file import write_recording
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar
from pretouch_registrar.replay import read_recorded, replay
from pretouch_simulation.in_process import InProcessRegistrar

from pretouch.cli import main
from pretouch.errors import InvalidInput
from pretouch.recording.session_file import SessionRecording, read_session_recording
from pretouch.tof import Sensor
from pretouch.v1.session_recording_pb2 import RecordedScan, RecordedSession
from pretouch.wire.json import estimate_to_json


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording of a session whose scans the registrar's own code has registered."""
    registrar = InProcessRegistrar(Engine.POSTERIOR, Registrar())
    record, events = recorded_session(scans=2, registrar=registrar)
    assert len(record.scans) == 2
    path = tmp_path_factory.mktemp("replay") / "session.mcap"
    path.write_bytes(write_recording(record, events))
    return path


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Any]:
    """`pretouch session replay` with these arguments: its exit code and what it writes."""

    def run(*arguments: str) -> tuple[Any, str, str]:
        monkeypatch.setattr(sys, "argv", ["pretouch", "session", "replay", *arguments])
        for name in [name for name in sys.modules if name.startswith("pretouch.session_command")]:
            monkeypatch.delitem(sys.modules, name)  # which commands it has is decided by the command line
        with pytest.raises(SystemExit) as ending:
            main()
        return (ending.value.code, *capsys.readouterr())

    return run


def test_the_numbers_are_the_recorded_ones_to_the_bit(file: Path) -> None:
    recording = read_session_recording(file)
    recorded = read_recorded(recording)
    assert recorded.settings.engine is Engine.POSTERIOR
    replayed = list(replay(recorded, recorded.settings, Registrar()))
    assert [each.identical for each in replayed] == [True, True]
    assert [each.distance for each in replayed] == [pytest.approx(0, abs=1e-12)] * 2
    last = recording.session.session.estimate
    assert replayed[-1].estimate.base_T_correction.matrix.ravel().tolist() == list(last.base_t_correction.matrix)
    assert replayed[-1].estimate.covariance.ravel().tolist() == list(last.covariance)


def test_the_command_says_so(file: Path, command: Callable[..., Any], tmp_path: Path) -> None:
    out = tmp_path / "replay.json"
    code, said, _ = command(str(file), "--json", str(out))
    assert code == 0
    assert "All 2 estimates are the recorded ones, to the bit." in said
    document = json.loads(out.read_text())
    assert document["identical"] is document["complete"] is True
    assert document["settings"]["engine"] == "posterior"
    assert [scan["scan_id"] for scan in document["scans"]] == ["scan-1", "scan-2"]
    for scan in document["scans"]:
        assert scan["recorded"]["covariance"] == scan["replayed"]["covariance"]


def test_other_settings_give_another_answer(file: Path, command: Callable[..., Any]) -> None:
    changes = (["--engine", "pcl"], ["--prior", "0.002", "0.01"], ["--range-std", "0.01"])
    answers = [json.loads(command(str(file), *change, "--json", "-")[1]) for change in changes]
    assert [answer["identical"] for answer in answers] == [False] * 3
    assert answers[0]["settings"]["engine"] == "pcl"
    assert answers[1]["settings"]["prior"] == {"translation_std": 0.002, "rotation_std": 0.01}
    assert answers[2]["settings"]["sensor"]["range_std"] == 0.01
    errors = [answer["scans"][-1]["replayed"]["expected_error"] for answer in answers]
    assert len(set(errors)) == 3
    assert "With these settings the answer is" in command(str(file), "--prior", "0.002", "0.01")[1]


def test_numbers_that_differ_are_said_with_the_versions(
    file: Path, command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    from pretouch_registrar import replay_command

    monkeypatch.setattr(replay_command, "describe_versions", lambda: {"pretouch": "9.9"})
    monkeypatch.setattr("pretouch_registrar.replay._serialise", lambda estimate: object())
    assert "2 of 2 estimates are not the recorded ones to the bit: pretouch" in command(str(file))[1]


def test_a_session_without_a_scan_replays_to_nothing(command: Callable[..., Any], tmp_path: Path) -> None:
    path = tmp_path / "none.mcap"
    path.write_bytes(write_recording(*recorded_session(scans=0)))
    code, said, _ = command(str(path))
    assert (code, "holds no scan" in said) == (0, True)


def test_what_is_no_recording_is_wrong_usage(command: Callable[..., Any], tmp_path: Path) -> None:
    path = tmp_path / "cube.stl"
    path.write_text("solid cube\n" * 100)
    code, said, error = command(str(path))
    assert (code, said) == (2, "")
    assert "no MCAP file" in error
    assert "Traceback" not in error


def test_values_that_no_session_has_are_refused(file: Path) -> None:
    recording = read_session_recording(file)
    session = RecordedSession()
    session.CopyFrom(recording.session)
    session.settings.engine = "psychic"
    with pytest.raises(InvalidInput, match="no engine 'psychic'"):
        read_recorded(SessionRecording(session, recording.scans, True))
    scan = RecordedScan()
    scan.CopyFrom(recording.scans[0])
    scan.scan.ranges.shape[:] = [3]
    with pytest.raises(InvalidInput, match="cannot be replayed"):
        read_recorded(SessionRecording(recording.session, (scan,), True))


def test_scans_before_the_first_return_change_nothing(file: Path) -> None:
    """As in a session, in which misses alone are not registered."""
    recorded = read_recorded(read_session_recording(file))
    blind = recorded.scans[0]
    nothing = type(blind)(blind.origins, blind.directions, np.full(len(blind), np.nan))
    changed = type(recorded)(
        recorded.scene, recorded.scan_ids[:1], (nothing,), recorded.estimates[:1], recorded.settings, recorded.at
    )
    (only,) = replay(changed, recorded.settings, Registrar())
    assert estimate_to_json(only.estimate, None)["base_T_correction"]["translation"] == [0.0, 0.0, 0.0]
    assert recorded.settings.sensor.range_max == Sensor().range_max
