"""Runs all benchmarks: `python -m benchmarks [--json OUT]`. Each measures beside a peer in the same run."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from benchmarks import ray_casting, replay, session_step, tell_latency

BENCHMARKS = {
    "ray_casting": ray_casting.measure,
    "replay": replay.measure,
    "session_step": session_step.measure,
    "tell_latency": tell_latency.measure,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    out = parser.parse_args().json
    figures = {}
    for name, measure in BENCHMARKS.items():
        figures[name] = measure()
        for figure, value in figures[name].items():
            print(f"{name}  {figure:34} {value:10.2f}")
    if out:
        out.write_text(json.dumps(figures, indent=1) + "\n")


main()
