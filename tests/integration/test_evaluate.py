"""`pretouch evaluate` end to end on meshes made in code: its rows, its determinism, and going on after an interrupt."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from helpers.made_frame import write_frame, write_mesh
from pretouch_simulation.objects import MAKERS

FIELDS = {
    "mesh": str,
    "view": int,
    "scan": int,
    "proposer": str,
    "engine": str,
    "planner": str,
    "sensor": str,
    "initial_error": float,
    "error": float,
    "expected_error": float,
    "covered": bool,
    "state": str,
    "fraction": float,
    "robot_seconds": float,
    "compute_ms": float,
    "camera": str,
    "scan_seconds": float,
    "returns": float,
    "scene": str,
}


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("meshes")
    for name in ("drill", "mug"):
        write_mesh(folder / f"{name}.obj", MAKERS[name]())
    return folder


def command(meshes: Path, out: Path, *options: str) -> list[str]:
    return [sys.executable, "-m", "pretouch", "evaluate", "--meshes", str(meshes), "--json", str(out), *options]


def evaluate(meshes: Path, out: Path, *options: str) -> dict[str, Any]:
    return answered(command(meshes, out, *options), out)


def answered(command: list[str], out: Path) -> dict[str, Any]:
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr[-2000:] + done.stdout[-2000:]
    answer = json.loads(out.read_text())
    assert not out.with_name(out.name + ".partial").exists()
    return dict(answer)


def timeless(answer: dict[str, Any]) -> list[dict[str, Any]]:
    return [{**row, "compute_ms": 0.0} for row in answer["rows"]]


def test_rows_have_the_agreed_form_and_do_not_depend_on_the_workers(meshes: Path, tmp_path: Path) -> None:
    options = ("--views", "1", "--scans", "2", "--proposer", "random")
    one = evaluate(meshes, tmp_path / "one.json", *options, "--workers", "1")
    two = evaluate(meshes, tmp_path / "two.json", *options, "--workers", "2")
    assert set(one) == {"command", "seed", "rows"}
    assert one["command"].startswith("pretouch evaluate --meshes")
    assert one["seed"] == 0
    for row in one["rows"]:
        assert {name: type(value) for name, value in row.items()} == FIELDS
        assert 0 < row["initial_error"] < 0.06
        assert 0 <= row["fraction"] <= 1
        assert row["robot_seconds"] >= row["scan_seconds"] > 0
        assert 0 <= row["returns"] <= 1
        assert row["scene"] == "alone"
    assert [(row["mesh"], row["view"], row["scan"]) for row in one["rows"]] == [
        (mesh, 0, scan) for mesh in ("drill", "mug") for scan in (1, 2)
    ]
    assert timeless(one) == timeless(two)
    last = [row for row in one["rows"] if row["scan"] == 2]
    assert sum(row["error"] for row in last) < 0.7 * sum(row["initial_error"] for row in last)


def test_real_frames_have_sessions_with_default_budgets(tmp_path: Path) -> None:
    write_frame(tmp_path)
    out = tmp_path / "out.json"
    options = ["--proposer", "random", "--engine", "paper", "--seeds", "1", "--seed", "4"]
    frames = [sys.executable, "-m", "pretouch", "evaluate", "--frames", str(tmp_path), "--json", str(out), *options]
    answer = answered(frames, out)
    assert answer["seed"] == 4
    rows = answer["rows"]
    for row in rows:
        fields = {**FIELDS, "frame": str, "error_fitted": float}
        assert {name: type(value) for name, value in row.items()} == {k: v for k, v in fields.items() if k != "scene"}
        assert (row["frame"], row["view"], row["camera"]) == ("frame", 4, "real")
        assert abs(row["error"] - row["error_fitted"]) < 0.002
    for name in ("box", "can"):
        states = [row["state"] for row in rows if row["mesh"] == name]
        assert 1 <= len(states) <= 10
        assert set(states[:-1]) <= {"awaiting_scan"}
        assert states[-1] in ("converged", "exhausted")


def test_several_engines_and_sensors_share_one_file(meshes: Path, tmp_path: Path) -> None:
    options = ("--only", "mug", "--views", "1", "--scans", "2", "--proposer", "random")
    setups = ("--engine", "posterior", "--engine", "paper", "--sensor", "ideal", "--sensor", "vl6180x")
    details = tmp_path / "details.jsonl"
    both = evaluate(meshes, tmp_path / "both.json", *options, *setups, "--details", str(details))
    found = [(row["sensor"], row["engine"], row["scan"]) for row in both["rows"]]
    expected = [(s, e, k) for s in ("ideal", "vl6180x") for e in ("posterior", "paper") for k in (1, 2)]
    assert found == expected
    assert len({row["initial_error"] for row in both["rows"]}) == 1
    alone = evaluate(meshes, tmp_path / "alone.json", *options, "--engine", "paper", "--sensor", "vl6180x")
    assert timeless(alone) == timeless(both)[6:]
    lines = [json.loads(line) for line in details.read_text().splitlines()]
    assert [(line["sensor"], line["engine"], line["scan"]) for line in lines] == expected
    for line, row in zip(lines, both["rows"], strict=True):
        assert (line["distance2"] <= 12.59) == row["covered"]
        assert sum(value**2 for value in line["whitened"]) == pytest.approx(line["distance2"])


def test_shared_scans_do_not_depend_on_the_engine(meshes: Path, tmp_path: Path) -> None:
    options = ("--only", "drill", "--views", "1", "--scans", "2", "--proposer", "random")
    setups = ("--engine", "posterior", "--engine", "paper")
    led = evaluate(meshes, tmp_path / "led.json", *options, *setups, "--shared-scans")
    leader, follower = led["rows"][:2], led["rows"][2:]
    assert [row["engine"] for row in follower] == ["paper", "paper"]
    for name in ("scan", "fraction", "robot_seconds"):
        assert [row[name] for row in leader] == [row[name] for row in follower]
    assert [row["error"] for row in leader] != [row["error"] for row in follower]
    alone = evaluate(meshes, tmp_path / "alone.json", *options, "--engine", "posterior")
    assert timeless(alone) == timeless({"rows": leader})


def test_the_papers_setting_has_rows_of_its_own(meshes: Path, tmp_path: Path) -> None:
    answer = evaluate(
        meshes, tmp_path / "paper.json", "--paper-setting", "--only", "drill", "--views", "1", "--scans", "3"
    )
    assert [row["scan"] for row in answer["rows"]] == [1, 2, 3]
    assert {(row["engine"], row["planner"], row["sensor"]) for row in answer["rows"]} == {
        ("paper", "confidence", "paper")
    }
    fractions = [row["fraction"] for row in answer["rows"]]
    assert fractions == sorted(fractions)
    assert fractions[0] > 0


def test_an_interrupted_evaluation_goes_on_where_it_stopped(meshes: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.json"
    partial = tmp_path / "out.json.partial"
    options = ("--only", "drill", "--scans", "1", "--proposer", "random", "--workers", "1")
    endless = command(meshes, out, *options, "--views", "10000")
    with subprocess.Popen(endless, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        give_up = time.monotonic() + 120
        while not (partial.exists() and partial.read_text().count("\n") > 1) and time.monotonic() < give_up:
            time.sleep(0.01)
        process.terminate()  # a shell's background job ignores SIGINT, and so would this process
        try:
            _, said = process.communicate(timeout=120)
        finally:
            process.kill()
    assert process.returncode == 130, said
    assert b"the same command goes on" in said
    assert not out.exists()
    kept = partial.read_text().splitlines()[1:]
    assert len(kept) >= 1
    views = len(kept) + 2
    answer = evaluate(meshes, out, *options, "--views", str(views))
    assert [row["view"] for row in answer["rows"]] == list(range(views))
    for line in kept:
        for row in json.loads(line)["rows"]:
            assert row in answer["rows"]


def test_a_wrong_mesh_is_named_and_the_others_are_kept(meshes: Path, tmp_path: Path) -> None:
    folder = tmp_path / "meshes"
    folder.mkdir()
    os.link(meshes / "mug.obj", folder / "mug.obj")
    (folder / "broken.ply").write_text("ply\n")
    out = tmp_path / "out.json"
    done = subprocess.run(
        command(folder, out, "--views", "1", "--scans", "1", "--proposer", "random"),
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 1
    assert "broken, view 0 failed" in done.stdout
    assert {row["mesh"] for row in json.loads(out.read_text())["rows"]} == {"mug"}


def test_the_rows_go_to_standard_output_alone_if_it_is_asked_for(meshes: Path, tmp_path: Path) -> None:
    options = ("--only", "mug", "--views", "1", "--scans", "1", "--proposer", "random")
    done = subprocess.run(
        command(meshes, Path("-"), *options), capture_output=True, text=True, timeout=240, cwd=tmp_path, check=False
    )
    assert done.returncode == 0, done.stderr
    assert [row["mesh"] for row in json.loads(done.stdout)["rows"]] == ["mug"]
    assert "After each scan" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_session_that_converged_says_so_and_stops(meshes: Path, tmp_path: Path) -> None:
    options = ("--only", "drill", "--views", "1", "--scans", "3", "--proposer", "random")
    answer = evaluate(meshes, tmp_path / "out.json", *options, "--tolerance", "0.02")
    assert [row["state"] for row in answer["rows"]][-1] == "converged"
    assert len(answer["rows"]) < 3
    never = evaluate(meshes, tmp_path / "never.json", *options)
    assert [row["state"] for row in never["rows"]] == ["awaiting_scan", "awaiting_scan", "exhausted"]


def test_other_things_may_stand_around_each_object(tmp_path: Path) -> None:
    for name in ("can", "box"):
        write_mesh(tmp_path / f"{name}.obj", MAKERS[name]())
    write_mesh(tmp_path / "mug.obj", MAKERS["mug"]())
    options = ("--only", "mug", "--views", "1", "--scans", "1", "--proposer", "random")
    alone, among = (evaluate(tmp_path, tmp_path / f"{len(more)}.json", *options, *more) for more in ([], ["--clutter"]))
    assert [row["scene"] for row in (*alone["rows"], *among["rows"])] == ["alone", "clutter"]
    assert alone["rows"][0]["error"] != among["rows"][0]["error"]


def test_a_guarded_tip_is_planned_otherwise(meshes: Path, tmp_path: Path) -> None:
    options = ("--only", "drill", "--views", "1", "--scans", "1", "--proposer", "random")
    safe = evaluate(meshes, tmp_path / "safe.json", *options)
    guarded = evaluate(meshes, tmp_path / "guarded.json", *options, "--guarded")
    assert safe["rows"][0]["initial_error"] == guarded["rows"][0]["initial_error"]
    assert safe["rows"][0]["error"] != guarded["rows"][0]["error"]


def test_a_missing_folder_is_said_in_two_lines(tmp_path: Path) -> None:
    done = subprocess.run(
        command(tmp_path / "none", tmp_path / "out.json"), capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 2
    assert "There is no folder" in done.stderr
    assert "Traceback" not in done.stderr
