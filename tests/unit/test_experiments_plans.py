"""`experiments.plans` compares the same sessions of several evaluations, by made-up rows."""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments import plans
from experiments.plans_sessions import PlannedSession, sessions_of
from pretouch.errors import InvalidInput, Malformed, NotFound


def rows_of(mesh: str, *errors: float, state: str = "exhausted", **more: Any) -> list[dict[str, Any]]:
    """A session: 4 s a scan, half of the samples return."""
    about = {"mesh": mesh, "view": 0, "camera": "kinect", "sensor": "ideal", "scene": "alone", "initial_error": 0.02}
    rows = [
        {**about, "scan": k, "error": error, "robot_seconds": 4.0 * k, "returns": 0.5, "covered": True, **more}
        for k, error in enumerate(errors, start=1)
    ]
    return [{**row, "state": "awaiting_scan"} for row in rows[:-1]] + [{**rows[-1], "state": state}]


def write(folder: Path, world: str, *sessions: list[dict[str, Any]]) -> Path:
    folder.mkdir(exist_ok=True)
    rows = [row for session in sessions for row in session]
    (folder / f"{world}.json").write_text(json.dumps({"command": "pretouch evaluate", "seed": 0, "rows": rows}))
    return folder


def test_seconds_count_the_way_to_each_scan() -> None:
    session = PlannedSession(rows_of("mug", 0.01, 0.002))
    assert session.seconds.tolist() == [5.5, 11.0]
    assert session.error_at(np.array([0.0, 5.4, 5.5, 10.9, 11.0, 99.0])).tolist() == [
        0.02,
        0.02,
        0.01,
        0.01,
        0.002,
        0.002,
    ]
    assert [session.error_after(scan) for scan in (1, 3, None)] == [0.01, 0.002, 0.002]


def test_a_line_describes_all_sessions_and_times_those_that_converged() -> None:
    rows = [
        *rows_of("mug", 0.01, 0.002, state="converged"),
        *rows_of("box", 0.005, state="converged", covered=False, returns=0.1),
        *rows_of("can", 0.03, 0.03, 0.02, 0.01),
    ]
    assert plans.describe(list(sessions_of(rows).values()), 0.003) == [
        *("3", "67%", "50%", "8.2", "10.4", "50%"),
        *("1.50", "1.00", "0.90", "0.50", "0.57", "0.50", "67%"),
    ]


def test_on_real_frames_the_fitted_error_and_two_millimetres_count() -> None:
    rows = rows_of("mug", 0.009, state="converged", error_fitted=0.0049, frame="0001")
    assert plans.describe(list(sessions_of(rows).values()), 0.003)[2] == "100%"


def test_where_nothing_converged_there_are_no_seconds() -> None:
    assert plans.describe([PlannedSession(rows_of("mug", 0.01))], 0.003)[1:5] == ["0%", "", "", ""]


def test_only_what_all_hold_is_compared(tmp_path: Path) -> None:
    before = write(tmp_path / "before", "window", rows_of("mug", 0.01), rows_of("box", 0.02))
    after = write(tmp_path / "after", "window", rows_of("can", 0.01), rows_of("mug", 0.003, 0.002))
    write(after, "cone", rows_of("mug", 0.01))
    worlds = plans.compare({folder.name: plans.read_folder(folder) for folder in (before, after)})
    assert list(worlds) == ["window"]
    assert {label: [s.last["mesh"] for s in sessions] for label, sessions in worlds["window"].items()} == {
        "before": ["mug"],
        "after": ["mug"],
    }


def test_the_page_and_the_picture_are_written(tmp_path: Path) -> None:
    before = write(tmp_path / "before", "window", rows_of("mug", 0.01), rows_of("box", 0.02))
    after = write(tmp_path / "after", "window", rows_of("mug", 0.002, state="converged"), rows_of("box", 0.002))
    out = tmp_path / "out"
    plans.run(argparse.Namespace(folders=[before, after], tolerance=0.003, out=out))
    page = (out / "plans.md").read_text()
    assert "## window" in page
    assert "| after | 2 | 50% | 100% | 5.5 | 5.5 | 50% |" in page
    assert (out / "plans.png").read_bytes().startswith(b"\x89PNG")


def test_what_cannot_be_compared_is_refused(tmp_path: Path) -> None:
    before, after = write(tmp_path / "before", "window", rows_of("mug", 0.01)), tmp_path / "after"
    for folders in ([before], [before, before]):
        with pytest.raises(InvalidInput, match="nothing to compare"):
            plans.run(argparse.Namespace(folders=folders, tolerance=0.003, out=tmp_path))
    after.mkdir()
    with pytest.raises(NotFound, match=r"no \.json file"):
        plans.read_folder(after)
    (after / "window.json").write_text("{}")
    with pytest.raises(Malformed, match="holds no rows"):
        plans.read_folder(after)
    write(
        after,
        "window",
        [{name: value for name, value in row.items() if name != "returns"} for row in rows_of("mug", 0.01)],
    )
    with pytest.raises(Malformed, match="returns"):
        plans.read_folder(after)
    write(after, "window", rows_of("box", 0.01))
    with pytest.raises(InvalidInput, match="in common"):
        plans.compare({folder.name: plans.read_folder(folder) for folder in (before, after)})
