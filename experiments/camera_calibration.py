"""How honest, how sharp and how watchful a camera's calibration by its sessions is.

    python -m experiments.camera_calibration campaigns [--campaigns 20] [--knocks 100] [--seed 0] [--workers 2]
    python -m experiments.camera_calibration pairs HAND.csv CAMERA.csv [.. ..] [--campaigns 20] [--seed 0]

`campaigns` draws campaigns of 12 sessions in worlds that the estimator does not know, and knocks after six of them; it
writes camera-calibration.json world by world, and camera-calibration.png. `pairs` takes two recordings of poses (time,
x, y, z, qx, qy, qz, qw), by the hand and by the camera, as a camera's sessions, and writes camera-pairs.json. Both
write camera-calibration.md anew, to --out, docs/results unless given. Set OPENBLAS_NUM_THREADS=1: matrices are small.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from pretouch_orchestrator.calibration import estimate_calibration
from pretouch_orchestrator.calibration.observation import difference

from experiments.camera_calibration_picture import save_picture
from experiments.camera_calibration_text import write_page
from experiments.camera_pairs import PairSession, read_recording, run_campaign
from experiments.camera_worlds import Campaign, Knock, Residual, World
from experiments.command_line import command_of, run_or_exit
from experiments.folders import RESULTS
from pretouch.errors import InvalidInput
from pretouch.geometry import Array
from pretouch.prior import Prior

CHI2_50, CHI2_95 = 5.348, 12.592
"""Quantiles of chi-square with 6 degrees of freedom."""
SESSIONS, KNOCKED_AT = 12, 6
KNOCKS = {
    **{f"{mm} mm": Knock(KNOCKED_AT, shift=mm / 1000) for mm in (5, 10, 20)},
    **{f"{deg} deg about the camera": Knock(KNOCKED_AT, turn=float(np.radians(deg))) for deg in (2, 5)},
    **{
        f"{deg} deg about the object": Knock(KNOCKED_AT, turn=float(np.radians(deg)), about_camera=False)
        for deg in (2, 5)
    },
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    kinds = parser.add_subparsers(required=True)
    campaigns, pairs = kinds.add_parser("campaigns"), kinds.add_parser("pairs")
    campaigns.set_defaults(run=run_worlds)
    campaigns.add_argument("--campaigns", type=int, default=20)
    campaigns.add_argument("--knocks", type=int, default=100, help="campaigns of each knock")
    campaigns.add_argument("--workers", type=int, default=2)
    pairs.set_defaults(run=run_pairs)
    pairs.add_argument("recordings", type=Path, nargs="+", help="HAND.csv CAMERA.csv, once or more often")
    pairs.add_argument("--campaigns", type=int, default=20)
    for kind in (campaigns, pairs):
        kind.add_argument("--seed", type=int, default=0)
        kind.add_argument("--out", type=Path, default=RESULTS)
    arguments = parser.parse_args()
    run_or_exit(arguments, arguments.run)


def worlds() -> Iterator[tuple[str, World]]:
    """What coverage and width are shown for."""
    for moving in (False, True):
        where = "moving" if moving else "fixed"
        for residual in Residual:
            yield f"{residual}, {where}", World(residual, moving=moving)
    yield "twice the residual", World(scale=2.0, moving=True)
    yield "half the residual", World(scale=0.5, moving=True)
    yield "15 % of the sessions wrong", World(wrong=0.15, moving=True)
    yield "all sessions weak", World(weak=1.0, moving=True)


def run_worlds(arguments: argparse.Namespace) -> None:
    """Writes the rows after each world, and the page at the end."""
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    wanted = len([*worlds(), *knocks()])
    with ProcessPoolExecutor(arguments.workers) as pool:
        for name, world in worlds():
            seeds = [(world, [arguments.seed, k]) for k in range(arguments.campaigns)]
            done = list(pool.map(_run_one, seeds))
            rows.append({"world": name, "campaigns": len(done), **_cover(done)})
            _save(arguments, "camera-calibration.json", rows, wanted)
        for name, world, knock in knocks():
            tasks = [(world, knock, [arguments.seed, k]) for k in range(arguments.knocks)]
            rows.append({"world": name, "campaigns": arguments.knocks, **_watch(list(pool.map(_run_knock, tasks)))})
            _save(arguments, "camera-calibration.json", rows, wanted)
    save_picture(rows, arguments.out / "camera-calibration.png")
    write_page(arguments.out)


def _save(arguments: argparse.Namespace, name: str, rows: list[dict[str, Any]], wanted: int) -> None:
    told = {"command": command_of("camera_calibration"), "seed": arguments.seed, "wanted": wanted, "rows": rows}
    (arguments.out / name).write_text(json.dumps(told, indent=1) + "\n")


def knocks() -> Iterator[tuple[str, World, Knock]]:
    """What the alarm is shown for: both kinds of sessions."""
    for name, knock in KNOCKS.items():
        yield name, World(moving=True), knock
        yield f"{name}, converged sessions", World(moving=True, converged=True), knock


def _run_one(task: tuple[World, list[int]]) -> dict[str, Any]:
    world, seed = task
    campaign = Campaign(world, np.random.default_rng(seed))
    sessions = campaign.run(SESSIONS)
    after = [one.calibration for one in sessions[1:]] + [estimate_calibration(campaign.observations)]
    return {
        "chi2": [one.chi2 for one in sessions],
        "error": [one.error for one in sessions],
        "translation": [float(np.sqrt(np.trace(one.prior.covariance[3:, 3:]) / 3)) for one in sessions],
        "rotation": [float(np.sqrt(np.trace(one.prior.covariance[:3, :3]) / 3)) for one in sessions],
        "wrong": [one.wrong for one in sessions],
        "state": [one.drift.state.value for one in after],
    }


def _run_knock(task: tuple[World, Knock, list[int]]) -> dict[str, Any]:
    """Sessions from the default prior, two of them after the knock, and the prediction of a third."""
    world, knock, seed = task
    campaign = Campaign(world, np.random.default_rng(seed), knock)
    for k in range(KNOCKED_AT + 2):
        campaign.hold(k)
    calibration = estimate_calibration(campaign.observations)
    camera, centroid, truth = campaign.hold(KNOCKED_AT + 2)
    prior = calibration.predict(camera, centroid) or Prior()
    off = difference(truth, prior.mean, centroid)
    return {
        "moved": calibration.drift.state == "moved",
        "chi2": float(off @ np.linalg.solve(prior.covariance, off)),
        "translation": float(np.sqrt(np.trace(prior.covariance[3:, 3:]) / 3)),
    }


def _cover(done: Sequence[dict[str, Any]]) -> dict[str, Any]:
    chi2, states, wrong = (np.array([one[name] for one in done]) for name in ("chi2", "state", "wrong"))
    begun = (states[:, 1:] == "moved") & (states[:, :-1] != "moved")
    suspected = (states == "suspected") & (np.arange(states.shape[1]) > 0)
    return {
        "coverage": (chi2 <= CHI2_95).mean(axis=0).tolist(),
        "held": float((chi2[:, 1:] <= CHI2_95).mean()),
        "held_50": float((chi2[:, 1:] <= CHI2_50).mean()),
        **{
            name: np.median([one[name] for one in done], axis=0).tolist()
            for name in ("translation", "rotation", "error")
        },
        "sessions": int(states.size),
        "known": int(chi2[:, 1:].size),
        "moved": int(begun.sum()),
        "suspected_right": int((suspected & ~wrong).sum()),
        "wrong": int(wrong.sum()),
        "wrong_told": int((wrong & (states != "steady")).sum()),
    }


def _watch(done: Sequence[dict[str, Any]]) -> dict[str, Any]:
    return {
        "flagged": float(np.mean([one["moved"] for one in done])),
        "held_after": float(np.mean([one["chi2"] <= CHI2_95 for one in done])),
        "translation_after": float(np.median([one["translation"] for one in done])),
    }


def run_pairs(arguments: argparse.Namespace) -> None:
    """Campaigns from each recording.

    Raises:
        InvalidInput: a hand's recording without its camera's.
    """
    paths = arguments.recordings
    if len(paths) % 2:
        raise InvalidInput(f"{len(paths)} recordings are not pairs.", "Give HAND.csv CAMERA.csv, once or more often.")
    rows = []
    for hand, camera in zip(paths[::2], paths[1::2], strict=True):
        recording = read_recording(hand, camera)
        shifts, turns = recording.residuals()
        done = [
            run_campaign(recording, np.random.default_rng([arguments.seed, k]), SESSIONS)
            for k in range(arguments.campaigns)
        ]
        rows.append(
            {
                "world": recording.name,
                "campaigns": arguments.campaigns,
                "pairs": len(shifts),
                "clock_offset": recording.offset,
                "residual_mm": (1000 * np.quantile(shifts, [0.5, 0.9, 0.99])).tolist(),
                "residual_deg": np.degrees(np.quantile(turns, [0.5, 0.9, 0.99])).tolist(),
                **_score(done),
            }
        )
    arguments.out.mkdir(parents=True, exist_ok=True)
    _save(arguments, "camera-pairs.json", rows, len(paths) // 2)
    write_page(arguments.out)


def _score(done: Sequence[Sequence[PairSession]]) -> dict[str, Any]:
    z = np.array([[one.z for one in campaign] for campaign in done])
    errors: Array = np.array([[one.error for one in campaign] for campaign in done])
    chi2 = (z**2).sum(axis=2)
    stds = [[np.sqrt(np.trace(one.prior.covariance[3:, 3:]) / 3) for one in campaign] for campaign in done]
    return {
        "coverage": (chi2 <= CHI2_95).mean(axis=0).tolist(),
        "held": float((chi2[:, 1:] <= CHI2_95).mean()),
        "held_50": float((chi2[:, 1:] <= CHI2_50).mean()),
        "before_mm": float(1000 * np.median(np.linalg.norm(errors[..., 3:], axis=2))),
        "before_deg": float(np.degrees(np.median(np.linalg.norm(errors[..., :3], axis=2)))),
        "translation": np.median(stds, axis=0).tolist(),
        "z": z[:, 1:].reshape(-1, 6).std(axis=0).tolist(),
        "alarms": sum(one.alarm for campaign in done for one in campaign),
    }


if __name__ == "__main__":
    main()
