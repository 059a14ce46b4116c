"""The network of `deep` on objects that it has not seen: what it foretells against what scans achieve.

    python experiments/validation.py [--meshes DIR] [--limit 30] [--candidates 14] [--offsets 8] [--out docs/results]

One view of each mesh of the side `validation`, the first so many in an order that mixes the sources. On each view all
candidates, random rectangles, are scanned alone with the same hidden calibration errors; the errors' means are
compared with what the network, `stability` and the registrar itself foretell. Then the first ten regions of `deep` are
scanned likewise. Writes validation.md, validation.json and validation.png. DIR
is data/meshes/train of PRETOUCH_SHARED unless given. A run that was stopped goes on.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from collecting import SHARED, collect
from command_line import start
from one_scan import CANDIDATES, Job, Row, Target, seen
from pretouch_detector.proposals import deep
from pretouch_detector.proposals.information import remaining_error
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.split import Split
from scipy.stats import spearmanr

from pretouch.errors import InvalidInput
from pretouch.geometry import Array
from pretouch.scene import Scene
from pretouch.session import Proposer
from pretouch.tof import Sensor

FIRST = 10
BEST = 3
_SETUP = "ideal"
_BINS = 8
Foretelling = Callable[[Scene, Array], Array]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", type=Path, default=SHARED / "data" / "meshes" / "train")
    parser.add_argument("--limit", type=int, default=30)
    parser.add_argument("--candidates", type=int, default=14)
    parser.add_argument("--offsets", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    start(parser, run)


def run(arguments: argparse.Namespace) -> None:
    """Makes the scans and writes everything into `arguments.out`.

    Raises:
        InvalidInput: no view has candidates that differ.
        Unavailable: the network cannot be read.
    """
    foretellers = foretellings()
    jobs = []
    for path in meshes_in(arguments.meshes, limit=arguments.limit, split=Split.VALIDATION):
        target, half = Target(path, 0), max(1, arguments.offsets // 2)
        jobs += [
            Job(target, _SETUP, CANDIDATES, arguments.candidates, arguments.offsets, arguments.seed),
            Job(target, _SETUP, Proposer.DEEP.value, FIRST, half, arguments.seed),
        ]
    settings = {"offsets": arguments.offsets, "seed": arguments.seed, "candidates": arguments.candidates}
    rows = collect(jobs, arguments.workers, arguments.out / "validation.partial", settings, "validation")
    views = [row for row in rows if row.subject == CANDIDATES and len(row.errors) > BEST]
    if not views:
        raise InvalidInput("No view has candidates that can be scanned.", "Give other meshes.")
    targets = {job.target.name: job.target for job in jobs}
    foretold = {
        name: [each(seen(targets[row.target], row.seed).scene, np.array(row.rectangles)) for row in views]
        for name, each in foretellers.items()
    }
    foretold["registrar (PredictScans)"] = [np.array(row.foreseen) for row in views]
    command = shlex.join(["python", "experiments/validation.py", *sys.argv[1:]])
    content = {
        "command": command,
        "seed": arguments.seed,
        "rows": [row.as_dict() for row in rows],
        "foretold": {name: [each.tolist() for each in values] for name, values in foretold.items()},
    }
    (arguments.out / "validation.json").write_text(json.dumps(content) + "\n")
    text = report(command, rows, views, foretold)
    draw(views, foretold["deep"], arguments.out / "validation.png")
    (arguments.out / "validation.md").write_text(text)
    (arguments.out / "validation.partial").unlink(missing_ok=True)
    print(text)


def foretellings() -> dict[str, Foretelling]:
    """What foretells the error of each rectangle (n, 5) of a scene; (n,), m."""
    scorer = deep.WEIGHTS.network()
    return {
        "deep": lambda scene, rectangles: deep.foretold(scorer, scene, Sensor(), rectangles),
        "stability": lambda scene, rectangles: remaining_error(scene, Sensor(), rectangles)[0],
    }


def report(command: str, rows: Sequence[Row], views: Sequence[Row], foretold: dict[str, list[Array]]) -> str:
    """The tables, in Markdown."""
    achieved = [np.mean(row.errors, axis=1) for row in views]
    halves = [
        spearman(np.mean(np.array(r.errors)[:, ::2], axis=1), np.mean(np.array(r.errors)[:, 1::2], axis=1))
        for r in views
    ]
    lines = [
        "# What is foretold against what is achieved",
        "",
        f"Made by `{command}`: {len(views)} views of as many objects of the side `validation`, "
        f"{len(views[0].errors)} random rectangles each, {views[0].offsets} hidden calibration errors, ideal finger, "
        f"engine `posterior`, one scan, seed {views[0].seed}. Correlations are Spearman's: over all rectangles of all "
        "views, and the mean ± standard error of those within a view. Between the two halves of the calibration errors "
        f"the achieved errors themselves correlate by {np.mean(halves):.2f} within a view, which bounds what can be "
        "foretold.",
        "",
        f"| foretold by | all | within a view | mean foretold / achieved, cm | achieved by its {BEST} best, cm |",
        "|---|---|---|---|---|",
    ]
    everyone = np.concatenate(achieved)
    for name, values in foretold.items():
        within = [spearman(told, got) for told, got in zip(values, achieved, strict=True)]
        best = np.mean([got[np.argsort(told)[:BEST]].mean() for told, got in zip(values, achieved, strict=True)])
        flat = np.concatenate(values)
        lines.append(
            f"| {name} | {spearman(flat, everyone):.2f} | {np.mean(within):.2f} ± "
            f"{np.std(within) / np.sqrt(len(within)):.2f} | {100 * flat.mean():.2f} / {100 * everyone.mean():.2f} "
            f"| {100 * best:.2f} |"
        )
    lines += ["", f"Any rectangle: {100 * everyone.mean():.2f} cm.", ""]
    by_deep = [np.mean(row.errors, axis=1) for row in rows if row.subject == Proposer.DEEP.value and row.errors]
    flat = np.concatenate(by_deep)
    lines += ["| first ten regions of | n | mean (std), cm |", "|---|---|---|"]
    lines.append(f"| deep | {len(flat)} | {100 * flat.mean():.2f} ({100 * flat.std():.2f}) |")
    return "\n".join([*lines, "", "![Foretold against achieved](validation.png)", ""])


def spearman(a: Array, b: Array) -> float:
    """Of two rows of numbers; 0 where one is the same throughout."""
    return float(spearmanr(a, b)[0]) if np.ptp(a) > 0 and np.ptp(b) > 0 else 0.0


def draw(views: Sequence[Row], foretold: Sequence[Array], path: Path) -> None:
    """Each rectangle's achieved error over the foretold one, and the means of bins with equally many."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import FixedLocator, NullLocator

    told = 100 * np.concatenate(foretold)
    got = 100 * np.concatenate([np.mean(row.errors, axis=1) for row in views])
    figure, axis = plt.subplots(figsize=(5, 4.6), layout="constrained")
    axis.loglog(told, got, ".", color="0.7", markersize=4, label=f"a rectangle, mean of {views[0].offsets} offsets")
    bins = np.array_split(np.argsort(told), _BINS)
    axis.errorbar(
        [told[k].mean() for k in bins], [got[k].mean() for k in bins],
        yerr=[got[k].std() / np.sqrt(len(k)) for k in bins], fmt="o", color="C0", label="bins of equally many",
    )  # fmt: skip
    ends = np.array([min(told.min(), got.min()), max(told.max(), got.max())])
    axis.plot(ends, ends, color="C3", linewidth=1, label="as foretold")
    axis.set(
        xlabel="foretold by deep, cm", ylabel="achieved, cm", title=f"{len(views)} validation objects, n = {len(told)}"
    )
    for side in (axis.xaxis, axis.yaxis):
        side.set_major_locator(FixedLocator([0.1, 0.2, 0.5, 1.0, 2.0, 5.0]))
        side.set_major_formatter("{x:g}")
        side.set_minor_locator(NullLocator())
    axis.legend(frameon=False)
    figure.savefig(path, dpi=100)
    plt.close(figure)


if __name__ == "__main__":
    main()
