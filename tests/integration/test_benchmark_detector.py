"""The detector's latency benchmark runs without torch, and reports that it is missing."""

import json
import subprocess
import sys
from pathlib import Path

from helpers import made_network

REPOSITORY = Path(__file__).parents[2]


def test_it_times_every_ready_proposer(tmp_path: Path) -> None:
    weights, out = made_network.write(tmp_path / "weights"), tmp_path / "out.json"
    words = ("--views", "1", "--repeats", "2", "--weights", weights, "--json", out)
    command = [sys.executable, "-m", "benchmarks.detector_latency", *words]
    run = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, timeout=240, check=False)
    assert run.returncode == 0, run.stderr
    times = json.loads(out.read_text())["proposing_ms"]
    assert list(times) == ["deep", "stability", "random", "narf"]
    assert all(len(each) == 2 and min(each) > 0 for each in times.values())
    assert "No comparison with torch" in run.stdout
