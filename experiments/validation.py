"""The network of `deep` on objects that it has not seen: what it predicts against what scans achieve.

    python -m experiments.validation [--meshes DIR] [--limit 30] [--candidates 14] [--offsets 8] [--out docs/results]

One view of each mesh of the side `validation`, the first so many in an order that mixes the sources. On each view all
candidates, random rectangles, are scanned alone with the same hidden calibration errors; the errors' means are
compared with what the network, `stability` and the registrar itself predict. Then the first ten regions of `deep` are
scanned likewise. Writes validation.md, validation.json and validation.png. DIR
is data/meshes/train of PRETOUCH_SHARED unless given. A run that was stopped goes on.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from pretouch_detector.proposals import deep
from pretouch_detector.proposals.information import predict_errors_after_scans
from pretouch_simulation.markdown import markdown_table
from pretouch_simulation.mesh_folder import meshes_in
from pretouch_simulation.partial_rows import PartialRows
from pretouch_simulation.split import Split

from experiments.collecting import run_jobs
from experiments.command_line import command_of, run_resumable
from experiments.folders import SHARED
from experiments.one_scan import CANDIDATES, Job, Row, Target, load_view
from experiments.rank_correlation import rank_correlation
from pretouch.errors import InvalidInput
from pretouch.geometry import Array
from pretouch.scene import Scene
from pretouch.session import Proposer
from pretouch.tof import Sensor

FIRST = 10
BEST = 3
_SETUP = "ideal"
_BINS = 8
Predictor = Callable[[Scene, Array], Array]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", type=Path, default=SHARED / "data" / "meshes" / "train")
    parser.add_argument("--limit", type=int, default=30)
    parser.add_argument("--candidates", type=int, default=14)
    parser.add_argument("--offsets", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    run_resumable(parser, run)


def run(arguments: argparse.Namespace) -> None:
    """Makes the scans and writes everything into `arguments.out`.

    Raises:
        InvalidInput: no view has candidates that differ.
        Unavailable: the network cannot be read.
    """
    ready = predictors()
    jobs = []
    for path in meshes_in(arguments.meshes, limit=arguments.limit, split=Split.VALIDATION):
        target, half = Target(path, 0), max(1, arguments.offsets // 2)
        jobs += [
            Job(target, _SETUP, CANDIDATES, arguments.candidates, arguments.offsets, arguments.seed),
            Job(target, _SETUP, Proposer.DEEP.value, FIRST, half, arguments.seed),
        ]
    settings = {"offsets": arguments.offsets, "seed": arguments.seed, "candidates": arguments.candidates}
    kept = PartialRows(arguments.out / "validation.partial", settings)
    rows = run_jobs(jobs, arguments.workers, kept, "validation")
    views = [row for row in rows if row.subject == CANDIDATES and len(row.errors) > BEST]
    if not views:
        raise InvalidInput("No view has candidates that can be scanned.", "Give other meshes.")
    targets = {job.target.name: job.target for job in jobs}
    predictions = {
        name: [each(load_view(targets[row.target], row.seed).scene, np.array(row.rectangles)) for row in views]
        for name, each in ready.items()
    }
    predictions["registrar (PredictScans)"] = [np.array(row.predicted) for row in views]
    command = command_of("validation")
    content = {
        "command": command,
        "seed": arguments.seed,
        "rows": [row.as_dict() for row in rows],
        "foretold": {name: [each.tolist() for each in values] for name, values in predictions.items()},
    }
    (arguments.out / "validation.json").write_text(json.dumps(content) + "\n")
    text = report(command, rows, views, predictions)
    save_picture(views, predictions["deep"], arguments.out / "validation.png")
    (arguments.out / "validation.md").write_text(text)
    kept.remove()
    print(text)


def predictors() -> dict[str, Predictor]:
    """What predicts the error of each rectangle (n, 5) of a scene; (n,), m."""
    scorer = deep.WEIGHTS.get_network()
    return {
        "deep": lambda scene, rectangles: deep.predict_errors(scorer, scene, Sensor(), rectangles),
        "stability": lambda scene, rectangles: predict_errors_after_scans(scene, Sensor(), rectangles)[0],
    }


def report(command: str, rows: Sequence[Row], views: Sequence[Row], predictions: dict[str, list[Array]]) -> str:
    """The tables, in Markdown."""
    achieved = [np.mean(row.errors, axis=1) for row in views]
    halves = [
        rank_correlation(np.mean(np.array(r.errors)[:, ::2], axis=1), np.mean(np.array(r.errors)[:, 1::2], axis=1))
        for r in views
    ]
    lines = [
        "# Predicted against achieved errors",
        "",
        f"Made by `{command}`: {len(views)} views of as many objects of the side `validation`, "
        f"{len(views[0].errors)} random rectangles each, {views[0].offsets} hidden calibration errors, ideal finger, "
        f"engine `posterior`, one scan, seed {views[0].seed}. Correlations are Spearman's: over all rectangles of all "
        "views, and the mean ± standard error of those within a view. Between the two halves of the calibration errors "
        f"the achieved errors themselves correlate by {np.mean(halves):.2f} within a view, which bounds what can be "
        "predicted.",
        "",
    ]
    headings = (
        *("predicted by", "all", "within a view", "mean predicted / achieved, cm"),
        f"achieved by its {BEST} best, cm",
    )
    table = []
    everyone = np.concatenate(achieved)
    for name, values in predictions.items():
        within = [rank_correlation(predicted, got) for predicted, got in zip(values, achieved, strict=True)]
        best = np.mean(
            [got[np.argsort(predicted)[:BEST]].mean() for predicted, got in zip(values, achieved, strict=True)]
        )
        flat = np.concatenate(values)
        table.append(
            [
                name,
                f"{rank_correlation(flat, everyone):.2f}",
                f"{np.mean(within):.2f} ± {np.std(within) / np.sqrt(len(within)):.2f}",
                f"{100 * flat.mean():.2f} / {100 * everyone.mean():.2f}",
                f"{100 * best:.2f}",
            ]
        )
    lines += [markdown_table(headings, table), f"Any rectangle: {100 * everyone.mean():.2f} cm.", ""]
    by_deep = [np.mean(row.errors, axis=1) for row in rows if row.subject == Proposer.DEEP.value and row.errors]
    flat = np.concatenate(by_deep)
    first_ten = ["deep", str(len(flat)), f"{100 * flat.mean():.2f} ({100 * flat.std():.2f})"]
    lines.append(markdown_table(["first ten regions of", "n", "mean (std), cm"], [first_ten]))
    return "\n".join([*lines, "![Predicted against achieved](validation.png)", ""])


def save_picture(views: Sequence[Row], predictions: Sequence[Array], path: Path) -> None:
    """Each rectangle's achieved error over the predicted one, and the means of bins with equally many."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import FixedLocator, NullLocator

    predicted = 100 * np.concatenate(predictions)
    got = 100 * np.concatenate([np.mean(row.errors, axis=1) for row in views])
    figure, axis = plt.subplots(figsize=(5, 4.6), layout="constrained")
    axis.loglog(
        predicted, got, ".", color="0.7", markersize=4, label=f"a rectangle, mean of {views[0].offsets} offsets"
    )
    bins = np.array_split(np.argsort(predicted), _BINS)
    axis.errorbar(
        [predicted[k].mean() for k in bins], [got[k].mean() for k in bins],
        yerr=[got[k].std() / np.sqrt(len(k)) for k in bins], fmt="o", color="C0", label="bins of equally many",
    )  # fmt: skip
    ends = np.array([min(predicted.min(), got.min()), max(predicted.max(), got.max())])
    axis.plot(ends, ends, color="C3", linewidth=1, label="as predicted")
    axis.set(
        xlabel="predicted by deep, cm",
        ylabel="achieved, cm",
        title=f"{len(views)} validation objects, n = {len(predicted)}",
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
