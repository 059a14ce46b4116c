"""How well each ranking of a view's rectangles predicts what scanning them achieves.

    python -m experiments.ranking --dataset DIR [--side train|validation] [--out docs/results]

DIR is a dataset of `pretouch labels generate --kind scans`: rectangles of views, some of them scanned on the displaced
mesh. `registrar` is the registrar's own, slow prediction; `stability` and `deep` are the proposers of that name. Within
each view Spearman's rank correlation is taken between the predicted errors and the mean error of the trials that were
made, and over all rectangles between the predicted errors and the registrar's prediction. A single trial depends mostly
on its random displacement, so that even a perfect prediction of the mean stays far below 1.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pretouch_detector.proposals import deep
from pretouch_detector.proposals.information import predict_errors_after_scans
from pretouch_detector.training.dataset import SIDES, Dataset, Example
from pretouch_simulation.markdown import markdown_table

from experiments.rank_correlation import rank_correlation
from pretouch.errors import InvalidInput
from pretouch.geometry import Array

LEAST = 5
"""The least number of scanned rectangles of a view that counts."""
REGISTRAR = "registrar"
Ranking = Callable[[Example], Array]


@dataclass(frozen=True)
class Outcome:
    """The outcome of one ranking in one view.

    Attributes:
        registrar, achieved: Spearman's correlation of the predicted errors with the registrar's, and with the trials.
        first: m, error achieved by the rectangle that is ranked first of those scanned.
    """

    registrar: float
    achieved: float
    first: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dataset", type=Path, required=True)
    parser.add_argument("--side", choices=SIDES, default="validation")
    parser.add_argument("--out", type=Path, help="also write ranking.md into this folder")
    arguments = parser.parse_args()
    text = report(Dataset(arguments.dataset), arguments.side)
    print(text)
    if arguments.out:
        (arguments.out / "ranking.md").write_text(text)


def rankings() -> dict[str, Ranking]:
    """The rankings that are ready."""
    ready: dict[str, Ranking] = {
        REGISTRAR: lambda example: example.predicted,
        "stability": lambda example: predict_errors_after_scans(example.scene, example.sensor, example.rectangles)[0],
    }
    if not deep.explain_unready():
        network = deep.WEIGHTS.get_network()
        ready["deep"] = lambda example: deep.predict_errors(network, example.scene, example.sensor, example.rectangles)
    return ready


def report(dataset: Dataset, side: str) -> str:
    """The table, in Markdown.

    Raises:
        InvalidInput: no view of that side has enough scanned rectangles.
    """
    ready = rankings()
    outcomes: dict[str, list[Outcome]] = {name: [] for name in ready}
    seconds = dict.fromkeys(ready, 0.0)
    objects, mean, least = set(), [], []
    for example in dataset.read_examples(side):
        errors = example.scores.mean(axis=1)
        scanned = np.isfinite(errors)
        if scanned.sum() < LEAST:
            continue
        objects.add(example.object)
        mean.append(float(errors[scanned].mean()))
        least.append(float(errors[scanned].min()))
        for name, ranking in ready.items():
            start = time.perf_counter()
            predicted = ranking(example)
            seconds[name] += time.perf_counter() - start
            first = float(errors[scanned][np.argmin(predicted[scanned])])
            outcomes[name].append(
                Outcome(
                    rank_correlation(predicted, example.predicted),
                    rank_correlation(predicted[scanned], errors[scanned]),
                    first,
                )
            )
    if not mean:
        raise InvalidInput(
            f"No view of the side {side} has {LEAST} scanned rectangles.", "Give a dataset of --kind scans."
        )
    return _format_table(outcomes, seconds, side, len(objects), mean, least)


def _format_table(
    outcomes: Mapping[str, list[Outcome]], seconds: Mapping[str, float], side: str, objects: int, mean: list[float],
    least: list[float],
) -> str:  # fmt: skip
    n = len(mean)
    lines = [
        f"# Rankings of rectangles against what their scans achieved: side {side}",
        "",
        f"n = {n} views of {objects} objects. Correlations are Spearman's within a view, mean ± its standard error.",
        "Of those scanned, a rectangle drawn blindly leaves "
        f"{100 * np.mean(mean):.2f} cm, the one with the luckiest trial {100 * np.mean(least):.2f} cm.",
        "",
    ]
    headings = (
        "ranking",
        "with the registrar's prediction",
        "with the error achieved",
        "error of the first, cm",
        "ms a view",
    )
    table = []
    for name, each in outcomes.items():
        first = 100 * np.mean([o.first for o in each])
        duration = "-" if name == REGISTRAR else f"{1000 * seconds[name] / n:.0f}"
        registrar = "-" if name == REGISTRAR else _format_with_error([o.registrar for o in each])
        achieved = _format_with_error([o.achieved for o in each])
        table.append([name, registrar, achieved, f"{first:.2f}", duration])
    return "\n".join([*lines, markdown_table(headings, table)])


def _format_with_error(values: list[float]) -> str:
    return f"{np.mean(values):.2f} ± {np.std(values) / np.sqrt(len(values)):.2f}"


if __name__ == "__main__":
    main()
