"""The gateway's benchmark runs and reports all of its figures; speed is not tested."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("psutil", reason="the benchmarks' extra is not installed")
REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    out = tmp_path_factory.mktemp("benchmark") / "gateway.json"
    command = [sys.executable, "-m", "benchmarks.gateway", "--quick", "--seed", "3", "--json", str(out)]
    subprocess.run(command, cwd=REPOSITORY, check=True, timeout=200)
    return dict(json.loads(out.read_text()))


def test_it_says_what_was_run_and_on_what(document: dict[str, Any]) -> None:
    assert document["command"].startswith("python -m benchmarks.gateway --quick --seed 3")
    assert document["seed"] == 3
    assert document["n"] == {"30 Hz": 20, "200 Hz": 200}
    assert document["machine"].keys() >= {"cpu", "cores", "system", "python", "grpcio", "load_before", "load_after"}


def test_latency_is_told_beside_the_peers_at_each_rate(document: dict[str, Any]) -> None:
    assert [(row["rate_hz"], row["n"], row["lost"]) for row in document["latency"]] == [(30, 20, 0), (200, 200, 0)]
    for row in document["latency"]:
        for name in ("p50", "p99"):
            figures = row[name]
            assert all(figures[part] > 0 for part in ("gateway", "pyserial", "gRPC stream"))
            assert len(figures["ratio_rounds"]) == row["rounds"]
            assert min(figures["ratio_rounds"]) <= figures["ratio"] <= max(figures["ratio_rounds"])
        assert all(row["p50"][part] <= row["max"][part] for part in ("gateway", "pyserial", "gRPC stream"))


def test_a_highest_rate_is_told_of_the_gateway_and_of_both_readers(document: dict[str, Any]) -> None:
    assert [row["reader"] for row in document["rate"]] == [
        "gateway",
        "pyserial + FrameDecoder",
        "pyserial, counting zeros",
    ]
    assert all(0 < row["highest_hz"] <= 2000 and row["held_s"] == 0.2 for row in document["rate"])


def test_cost_is_told_without_listeners_and_with_them_and_of_the_peers(document: dict[str, Any]) -> None:
    alone, listened, peers = document["cost"]
    assert [row["devices"] for row in (alone, listened, peers)] == [2, 2, 2]
    assert listened["delivered"] == 2 * round(30 * (0.5 + 2 * 0.3))
    assert listened["lost"] == 0
    assert all(row["rss_mb"] > row["uss_mb"] > 1 for row in (alone, listened))
    assert peers["rss_mb"] is None
    assert all(row["core_share"] > 0 and row["us_per_frame"] > 0 for row in (listened, peers))


def test_the_soak_delivers_and_records_every_frame_and_tells_the_memory(document: dict[str, Any]) -> None:
    soak = document["soak"]
    assert soak["sent"] == soak["delivered"] == 8 * 45
    assert soak["lost"] == soak["unrecorded"] == 0
    assert soak["recorded_mb"] > 0
    assert len(soak["t_s"]) == len(soak["rss_kb"]) == 7
    slopes = soak["slope_kb_per_minute"], soak["slope_without_history_kb_per_minute"]
    assert slopes[0] - slopes[1] == pytest.approx(soak["history_kb_per_minute"], abs=1e-3)
