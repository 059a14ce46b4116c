"""Calibration files: whole or refused, and never half written."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pretouch_sensor_gateway.calibration.file import MAX_BYTES, load, save
from pretouch_sensor_gateway.calibration.model import Calibration, ModuleCalibration
from pretouch_sensor_gateway.calibration.record import CalibrationRecord, ModuleFit, Point, StandardErrors

from pretouch.errors import InvalidInput, Malformed

BENT = ModuleCalibration(
    0.0031, 1.012, 4.5, 0.0008, 0.011, 0.0004, corrections=((0.015, 0.0002), (0.1, -0.0003)), span=(0.015, 0.1)
)
MODULES = (BENT, ModuleCalibration())
CALIBRATION = Calibration("0102030405060708", 60.0, MODULES, 0.0006)
OPTIONAL = ("made", "bias_std_m", "residual_m", "span_m", "corrections_m")
RECORD = CalibrationRecord(
    "2025-01-31T12:00:00+00:00",
    "left",
    (
        ModuleFit(
            MODULES[0],
            StandardErrors(0.0002, 0.004, 1.1, 0.00005, 0.002),
            0.001,
            (Point(0.015, 0.0181, 0.0009, 59, (0.041,), -0.0001), Point(0.1, 0.1003, 0.0019, 60, (), 0.0001)),
        ),
        ModuleFit(problem="no returns"),
    ),
)


@pytest.fixture
def document(tmp_path: Path) -> dict[str, Any]:
    save(tmp_path / "good.json", CALIBRATION, RECORD)
    document: dict[str, Any] = json.loads((tmp_path / "good.json").read_bytes())
    return document


def refused(path: Path, content: str | bytes | dict[str, Any]) -> InvalidInput:
    if isinstance(content, dict):
        content = json.dumps(content)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InvalidInput) as caught:
        load(path)
    assert caught.value.detail.startswith(str(path))
    assert "pretouch gateway calibrate" in caught.value.remedy
    return caught.value


@pytest.mark.parametrize("record", [None, RECORD])
def test_what_was_saved_is_loaded(tmp_path: Path, record: CalibrationRecord | None) -> None:
    save(tmp_path / "c.json", CALIBRATION, record)
    assert load(tmp_path / "c.json") == (CALIBRATION, record)
    assert [path.name for path in tmp_path.iterdir()] == ["c.json"]


@given(offset=st.floats(-0.1, 0.1), scale=st.floats(0.5, 2), crosstalk=st.floats(0, 1e4), std=st.floats(1e-6, 0.1))
def test_every_digit_is_kept(
    tmp_path_factory: pytest.TempPathFactory, offset: float, scale: float, crosstalk: float, std: float
) -> None:
    path = tmp_path_factory.getbasetemp() / "digits.json"
    calibration = Calibration("", 0.0, (ModuleCalibration(offset, scale, crosstalk, std),))
    save(path, calibration)
    assert load(path)[0] == calibration


def test_a_file_of_version_1_is_read_or_written_by_a_person(tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text(
        '{"version": 1, "serial": "", "warm_up_s": 60, "modules": ['
        '{"offset_m": 0.003, "scale": 1, "crosstalk_per_m2": 0, "std_m": 0.001, "std_slope": 0.01}]}'
    )
    assert load(tmp_path / "c.json") == (Calibration("", 60.0, (ModuleCalibration(0.003, 1, 0, 0.001, 0.01),)), None)


def test_a_person_reads_it_in_short_lines(tmp_path: Path) -> None:
    save(tmp_path / "c.json", CALIBRATION, RECORD)
    lines = (tmp_path / "c.json").read_text().splitlines()
    assert sum('"offset_m": 0.0,' in line and '"residual_m": 0.0' in line for line in lines) == 1
    assert sum('"corrections_m": [[0.015, 0.0002], [0.1, -0.0003]]' in line for line in lines) == 1
    assert sum('"distance_m": 0.015' in line and '"residual_m": -0.0001' in line for line in lines) == 1
    assert max(map(len, lines)) < 200


def test_every_file_that_was_cut_off_is_refused(tmp_path: Path) -> None:
    save(tmp_path / "c.json", CALIBRATION, RECORD)
    whole = (tmp_path / "c.json").read_bytes().rstrip()
    for length in range(0, len(whole), 7):
        assert isinstance(refused(tmp_path / "cut.json", whole[:length]), Malformed)


def _members(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The path of every member in a JSON document."""
    found = []
    for key, item in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        if isinstance(key, str):
            found.append((*path, key))
        found += _members(item, (*path, key))
    return found


def _parent(document: Any, path: tuple[Any, ...]) -> Any:
    for key in path[:-1]:
        document = document[key]
    return document


def test_every_member_is_needed_and_typed(tmp_path: Path, document: dict[str, Any]) -> None:
    paths = _members(document)
    assert len(paths) > 40
    for path in paths:
        for change in ("missing", "renamed", "retyped", "null"):
            broken = json.loads(json.dumps(document))
            parent = _parent(broken, path)
            value = parent.pop(path[-1])
            if change == "renamed":
                parent[f"{path[-1]}_mm"] = value
            elif change == "retyped":
                parent[path[-1]] = 1.0 if isinstance(value, str) else "1.0"
            elif change == "null":
                parent[path[-1]] = None
            if path[-1] in OPTIONAL and change == "missing":
                continue
            assert path[-1] in refused(tmp_path / "c.json", broken).detail, (path, change)


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (("version",), 3, "version is 3"),
        (("version",), True, "version"),
        (("serial",), "left finger", "serial"),
        (("warm_up_s",), -1, "warm_up is -1"),
        (("modules",), [], "0 modules"),
        (("modules", 1, "scale"), 1000, "modules[1]: scale is 1000"),
        (("modules", 0, "offset_m"), 3.1, "modules[0]: offset is 3.1"),
        (("bias_std_m",), 1, "bias_std is 1"),
        (("modules", 0, "span_m"), [0.1], "modules[0].span_m"),
        (("modules", 0, "corrections_m", 1), [0.001, 0.0], "modules[0]: corrections"),
        (("made", "date"), "yesterday", "made.date"),
        (("made", "modules"), [], "made.modules has 0 items, modules 2"),
        (("made", "modules", 0, "distances", 1, "samples"), 59.5, "made.modules[0].distances[1].samples"),
    ],
)
def test_a_value_that_makes_no_sense_is_named(
    tmp_path: Path, document: dict[str, Any], path: tuple[Any, ...], value: Any, said: str
) -> None:
    _parent(document, path)[path[-1]] = value
    assert said in refused(tmp_path / "c.json", document).detail


@pytest.mark.parametrize("word", ["NaN", "Infinity", "-Infinity", "1e999", "9" * 400, "9" * 5000])
def test_a_number_that_is_none_is_refused(tmp_path: Path, document: dict[str, Any], word: str) -> None:
    text = json.dumps(document).replace("1.012", word, 1)
    assert isinstance(refused(tmp_path / "c.json", text), Malformed)


@pytest.mark.parametrize(
    "content",
    [b"", b"\xff\xfe\x00", b"[" * 100_000, b"calibration", b"[]", b"null", b"1", b" " * (MAX_BYTES + 1)],
    ids=["empty", "bytes", "deep", "word", "list", "null", "number", "huge"],
)
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    refused(tmp_path / "c.json", content)


def test_a_member_given_twice_is_refused(tmp_path: Path, document: dict[str, Any]) -> None:
    text = json.dumps(document).replace('"scale": 1.012', '"scale": 1.012, "scale": 1.5', 1)
    assert "'scale' twice" in refused(tmp_path / "c.json", text).detail


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"none\.json: it cannot be read: No such file"):
        load(tmp_path / "none.json")
    with pytest.raises(InvalidInput, match="directory"):
        load(tmp_path)


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "c.json"
    save(path, CALIBRATION)
    before = path.read_bytes()

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InvalidInput, match="cannot be written: No space left"):
        save(path, Calibration())
    assert path.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == ["c.json"]


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="cannot be written"):
        save(tmp_path / "none" / "c.json", CALIBRATION)
