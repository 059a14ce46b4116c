"""Sessions on real depth frames, by the paper's engine and by ours: a table of the errors before and after.

    python experiments/frames.py [--frames DIR] [--seeds 3] [--out docs/results]

Every frame of DIR, every object in it with more than 1000 pixels of depth, `--seeds` hidden calibration errors each,
through running services. DIR is data/real_depth/ycb_video of PRETOUCH_SHARED unless given.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pretouch_registrar.engines import Engine
from pretouch_simulation.finger import FingerModel
from pretouch_simulation.frame_demo import engine_variable, run_frame
from pretouch_simulation.frames import frame_case, load_frame
from pretouch_simulation.protocol import Case
from pretouch_simulation.services import Services
from rich.console import Console
from rich.progress import track

from pretouch.errors import NotFound, PretouchError

ENGINES = (Engine.PAPER, Engine.POSTERIOR)
MIN_PIXELS = 1000
SHARED = Path(os.environ.get("PRETOUCH_SHARED", Path(__file__).resolve().parents[2] / "shared"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=Path, default=SHARED / "data" / "real_depth" / "ycb_video")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--sensor", type=FingerModel, choices=list(FingerModel), default=FingerModel.IDEAL)
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parents[1] / "docs" / "results")
    arguments = parser.parse_args()
    try:
        run(arguments.frames, arguments.seeds, arguments.sensor, arguments.out)
    except PretouchError as error:
        sys.exit(f"{error.detail} {error.remedy}")


def run(folder: Path, seeds: int, sensor: FingerModel, out: Path) -> None:
    """Writes frames.json and frames.md into `out`."""
    runs = [(case, name) for case, name in _cases(folder, seeds)]
    rows: list[dict[str, Any]] = []
    for engine in ENGINES:
        with Services(environment=engine_variable(engine)) as services:
            for case, name in track(runs, f"engine {engine}", console=Console(stderr=True)):
                frame = case.name.split()[0]
                result = run_frame(services, case, sensor).as_dict()
                rows.append({"frame": frame, "object": name, "seed": case.view, "engine": engine.value, **result})
    out.mkdir(parents=True, exist_ok=True)
    content = {"sensor": sensor.value, "seeds": seeds, "rows": rows}
    (out / "frames.json").write_text(json.dumps(content, indent=1) + "\n")
    table = markdown(rows, seeds, sensor)
    (out / "frames.md").write_text(table)
    print(table)


def _cases(folder: Path, seeds: int) -> Iterator[tuple[Case, str]]:
    paths = sorted(folder.glob("*.json"))
    if not paths:
        raise NotFound(f"There are no frames in {folder}.", "Give --frames, or set PRETOUCH_SHARED.")
    for path in paths:
        frame = load_frame(path)
        for thing in frame.objects:
            if frame.mask(thing.name).sum() > MIN_PIXELS:
                for seed in range(seeds):
                    yield frame_case(frame, thing.name, seed), thing.name


def markdown(rows: Sequence[dict[str, Any]], seeds: int, sensor: FingerModel) -> str:
    """The rows by object and engine, in centimetres."""
    frames = len({row["frame"] for row in rows})
    lines = [
        f"Real depth frames: {frames} frames, {seeds} hidden calibration errors for each object, {sensor} finger.",
        "Mean error of the object's points in cm.",
        "",
        "| object | engine | n | before | after: mean | median | std | p95 | > 1 cm | scans | scanned | robot s |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    names = sorted({row["object"] for row in rows})
    for name in [*names, "all"]:
        for engine in ENGINES:
            chosen = [row for row in rows if row["engine"] == engine.value and name in (row["object"], "all")]
            lines.append(_line(name, engine, chosen))
    return "\n".join(lines) + "\n"


def _line(name: str, engine: Engine, rows: Sequence[dict[str, Any]]) -> str:
    def column(key: str) -> Any:
        return np.array([row[key] for row in rows], dtype=np.float64)

    after = 100 * column("final_error")
    cells = (
        name,
        engine.value,
        str(len(rows)),
        f"{100 * column('initial_error').mean():.2f}",
        *(f"{value:.2f}" for value in (after.mean(), np.median(after), after.std(), np.quantile(after, 0.95))),
        f"{(after > 1).mean():.0%}",
        f"{column('scans').mean():.1f}",
        f"{column('fraction').mean():.1%}",
        f"{column('seconds').mean():.1f}",
    )
    return "| " + " | ".join(cells) + " |"


if __name__ == "__main__":
    main()
