"""Error against the share scanned: the steps by hand numbers, and `sequence.py` end to end on a mesh made in code."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.made_frame import write_mesh
from pretouch_simulation.objects import MAKERS

from experiments import sessions

ONE = sessions.Course("cup", 0, "deep", "confidence", 0.02, (0.06, 0.11), (0.008, 0.002))
ENDED = sessions.Course("box", 0, "deep", "confidence", 0.01, (0.10,), (0.004,))


def test_an_error_holds_until_the_next_scan_is_wholly_within_the_share() -> None:
    shares = [0.0, 0.059, 0.06, 0.10, 0.11, 0.5]
    assert sessions.errors_at([ONE], shares)[0].tolist() == [0.02, 0.02, 0.008, 0.008, 0.002, 0.002]
    assert sessions.errors_at([ENDED], shares)[0].tolist() == [0.01, 0.01, 0.01, 0.004, 0.004, 0.004]


def test_a_session_that_ended_counts_with_its_end() -> None:
    assert sessions.means_after_scan([ONE, ENDED], 0) == pytest.approx((0.0, 0.015))
    assert sessions.means_after_scan([ONE, ENDED], 1) == pytest.approx((0.08, 0.006))
    assert sessions.means_after_scan([ONE, ENDED], 2) == pytest.approx((0.105, 0.003))


def test_a_level_is_reached_where_the_mean_first_is_that_low() -> None:
    # The mean: 15 mm, from 6 % on 9 mm, from 10 % on 6 mm, from 11 % on 3 mm.
    assert sessions.share_to_reach([ONE, ENDED], 0.0091) == pytest.approx(0.06)
    assert sessions.share_to_reach([ONE, ENDED], 0.0031) == pytest.approx(0.11)
    assert np.isnan(sessions.share_to_reach([ONE, ENDED], 0.0029))


def test_sequence_is_made_for_both_planners(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    write_mesh(tmp_path / "meshes" / "drill.obj", MAKERS["drill"]())
    command = [sys.executable, "-m", "experiments.sequence", "--meshes", str(tmp_path / "meshes")]
    command += ["--proposers", "random", "--scans", "1", "--workers", "1", "--pictures", "1", "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr[-2000:]
    rows = json.loads((tmp_path / "sequence.json").read_text())["rows"]
    assert [(row["planner"], len(row["errors"])) for row in rows] == [("confidence", 1), ("information", 1)]
    assert rows[0]["initial"] == rows[1]["initial"]
    text = (tmp_path / "sequence.md").read_text()
    assert "| confidence | random | 1 |" in text
    assert "seed 0" in text
    assert not (tmp_path / "sequence.partial").exists()
    for name in ("sequence.png", "sequence-clouds.png"):
        assert (tmp_path / name).stat().st_size > 1000
