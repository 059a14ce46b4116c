"""`transfer.py`: which frames are taken, and the whole command on a frame made in code."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.made_frame import write_frame

from experiments import transfer
from pretouch.errors import NotFound


def test_of_each_video_the_first_and_the_last_frame_are_taken(tmp_path: Path) -> None:
    for name in ("0000_2", "0000_1", "0000_9", "0003_7"):
        (tmp_path / f"{name}.json").write_text("{}")
    assert [path.stem for path in transfer.frames_of(tmp_path)] == ["0000_1", "0000_9", "0003_7"]
    with pytest.raises(NotFound):
        transfer.frames_of(tmp_path / "nowhere")


def test_transfer_is_made_of_frames_with_and_without_truth(tmp_path: Path) -> None:
    frames, out = tmp_path / "frames", tmp_path / "out"
    frames.mkdir()
    write_frame(frames)
    command = [sys.executable, "-m", "experiments.transfer", "--frames", str(frames), "--scenes", str(frames)]
    command += ["--proposers", "random", "--offsets", "1", "--settings", "paper", "--workers", "1", "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr[-2000:]
    rows = json.loads((out / "transfer.json").read_text())["rows"]
    assert [(row["object"], len(row["errors"])) for row in rows] == [("box", 10), ("can", 10)]
    assert all(0 < error[0] < 0.1 for row in rows for error in row["errors"])
    text = (out / "transfer.md").read_text()
    assert "n = 2 objects, 2 views" in text
    assert "random: median" in text
    for name in ("transfer.png", "transfer-random.png"):
        assert (out / name).stat().st_size > 1000
