"""Sessions that are told a prior: truth plus noise of the size that it states, beside the default prior.

    python -m experiments.priors [--meshes DIR] [--split validation] [--limit 10] [--kinds ..] [--out docs/results]

One view of each mesh, camera `random`, fingers `ideal` and `random`, tolerance 3 mm and the default budget. Kinds:

- `default`: no prior is given.
- `3mm`: 3 mm and 0.6 deg along every axis.
- `plane`: 1 mm and 3 deg in the table's plane, 1 cm along its normal and 0.6 deg about the others.
- `wrong`: states the same as `3mm`, but its mean is 20 mm off in a random direction of the table's plane.

Writes priors.json, a row for each session, and priors.md.
"""

from __future__ import annotations

import argparse
import asyncio
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.evaluation import run_session
from pretouch_simulation.evaluation_protocol import Protocol, adopt_default_budget
from pretouch_simulation.evaluation_tasks import MeshTask
from pretouch_simulation.finger import FingerModel
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.protocol import Case, generator
from pretouch_simulation.split import Split

from pretouch.geometry import Array, Pose, rotation_from_vector
from pretouch.prior import PosePrior
from pretouch.session import Planner, Proposer

TOLERANCE = 0.003
_STDS = {
    "3mm": np.array([*np.radians([0.6, 0.6, 0.6]), 0.003, 0.003, 0.003]),
    "plane": np.array([*np.radians([0.6, 0.6, 3.0]), 0.001, 0.001, 0.01]),
}
_STDS["wrong"] = _STDS["3mm"]
KINDS = ("default", *_STDS)
_KNOCK = 0.02
"""m: how far a wrong prior's mean is off."""
SENSORS = (FingerModel.IDEAL, FingerModel.RANDOM)


@dataclass(frozen=True)
class Row:
    """A session's end: m and s; `covered` is whether the truth lies in the last 95 % region, `told` whether the session
    said that the prior is contradicted."""

    mesh: str
    sensor: str
    kind: str
    initial_error: float
    error: float
    error_quantile: float
    covered: bool
    state: str
    scans: int
    robot_seconds: float
    told: bool
    first_error: float
    first_covered: bool


def draw_prior(case: Case, kind: str, seed: int) -> PosePrior | None:
    """The prior of a session on `case`: its mean is the truth after an error drawn from its covariance."""
    if kind == "default":
        return None
    stds = _STDS[kind]
    rng = generator("prior", seed, case.name, case.view, kind)
    offset = stds * rng.standard_normal(6)
    if kind == "wrong":
        angle = rng.uniform(-np.pi, np.pi)
        offset[3:] += _KNOCK * np.array([np.cos(angle), np.sin(angle), 0.0])
    return PosePrior(_before_error(case.truth, offset, case.cloud.mean(axis=0)), np.diag(stds**2))


def _before_error(truth: Pose, error: Array, centroid: Array) -> Pose:
    """The correction of which `error` (6,), as in `Estimate.covariance`, leads to the truth."""
    rotation = rotation_from_vector(error[:3]).T @ truth.rotation
    return Pose.of(rotation, truth.apply(centroid) - error[3:] - rotation @ centroid)


def run(case: Case, sensor: FingerModel, kind: str, seed: int, registrar: Registrar) -> Row | None:
    """Runs the session to its end; None if no scan could be made."""
    protocol = adopt_default_budget(
        Protocol(
            10, Proposer.STABILITY, Engine.POSTERIOR, Planner.INFORMATION, sensor, seed, TOLERANCE,
            camera=CameraModel.RANDOM,
        )
    )  # fmt: skip
    prior = draw_prior(case, kind, seed)
    steps = asyncio.run(run_session(case, protocol, registrar, prior=prior))
    if not steps:
        return None
    first, last = steps[0].record, steps[-1].record
    return Row(
        mesh=case.name,
        sensor=sensor.value,
        kind=kind,
        initial_error=case.error(last.prior.mean),
        error=case.error(last.estimate.base_T_correction),
        error_quantile=last.estimate.error_quantile,
        covered=case.is_covered_by(last.estimate),
        state=last.state.value,
        scans=len(last.scans),
        robot_seconds=last.budget_used.seconds,
        told=any(warning.code == "prior-contradicted" for warning in last.warnings),
        first_error=case.error(first.estimate.base_T_correction),
        first_covered=case.is_covered_by(first.estimate),
    )


def summarize(rows: Sequence[Row]) -> list[str]:
    """A Markdown table, one line for each finger and kind."""
    lines = [
        "| finger | prior | n | error before, mm | after a scan, mm | at the end, mm | in the 95 % region: one scan, "
        "end | converged | of those within 3 mm | robot s, median | p90 | contradiction told |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for sensor in SENSORS:
        for kind in KINDS:
            own = [row for row in rows if (row.sensor, row.kind) == (sensor.value, kind)]
            if not own:
                continue
            median = {
                name: float(np.median([getattr(row, name) for row in own]))
                for name in ("initial_error", "first_error", "error", "robot_seconds")
            }
            done = [row for row in own if row.state == "converged"]
            right = sum(row.error <= TOLERANCE for row in done)
            lines.append(
                f"| {sensor.value} | {kind} | {len(own)} | {1000 * median['initial_error']:.1f} "
                f"| {1000 * median['first_error']:.1f} | {1000 * median['error']:.1f} "
                f"| {sum(row.first_covered for row in own)}, {sum(row.covered for row in own)} "
                f"| {len(done)} | {right} | {median['robot_seconds']:.1f} "
                f"| {np.quantile([row.robot_seconds for row in own], 0.9):.1f} | {sum(row.told for row in own)} |"
            )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", type=Path, default=Path("../shared/data/meshes/train"))
    parser.add_argument("--split", type=Split, default=Split.VALIDATION)
    parser.add_argument("--limit", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--sensors", nargs="+", type=FingerModel, default=SENSORS)
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    arguments = parser.parse_args()
    rows, registrar = list[Row](), Registrar()
    for path in meshes_in(arguments.meshes, limit=arguments.limit, split=arguments.split):
        case = MeshTask(path, 0).case(arguments.seed, CameraModel.RANDOM)
        for sensor in arguments.sensors:
            for kind in arguments.kinds:
                row = run(case, sensor, kind, arguments.seed, registrar)
                if row is None:
                    print(f"{case.name}, {sensor}, {kind}: no scan", flush=True)
                    continue
                rows.append(row)
                print(json.dumps(asdict(row)), flush=True)
                (arguments.out / "priors.json").write_text(json.dumps({"rows": [asdict(row) for row in rows]}) + "\n")
    (arguments.out / "priors.md").write_text("\n".join(summarize(rows)) + "\n")


if __name__ == "__main__":
    main()
