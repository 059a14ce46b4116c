"""`python -m examples.physics_arm`: runs of several objects and seeds, and a table of how well each ended."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import ExitStack

import numpy as np
from pretouch_simulation.services import Services

from examples.physics_arm.objects import OBJECTS
from examples.physics_arm.run import Result, run
from pretouch.client import RestClient
from pretouch.errors import PretouchError
from pretouch.session import State, Tolerance

_HEADER = (
    "| object | n | before, mm (mean) | after, mm (median, worst) | expected, mm (median) | truth in the 95 % region "
    "| converged | of these within it | scans (mean) | robot seconds (mean) | skipped scans | motions with a touch |"
)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m examples.physics_arm", description=__doc__)
    parser.add_argument("--url", help="REST of a running pretouch; left out: one is started")
    parser.add_argument("--objects", nargs="+", choices=OBJECTS, default=list(OBJECTS))
    parser.add_argument("--seeds", type=int, default=3, help="runs of each object")
    parser.add_argument("--tolerance", type=float, default=0.003, help="m within which a pose is good enough")
    options = parser.parse_args()
    if options.seeds < 1:
        parser.error(f"--seeds is {options.seeds}; need 1 or more")
    with ExitStack() as stack:
        url = options.url or stack.enter_context(Services()).rest
        client = stack.enter_context(RestClient(url, timeout=120))
        results = []
        for name in options.objects:
            for seed in range(options.seeds):
                results.append(run(client, name, seed, Tolerance(options.tolerance)))
                print(_line(results[-1]), flush=True)
    print()
    print(_HEADER)
    print("|" + "---|" * (_HEADER.count("|") - 1))
    for name in options.objects:
        print(_row(name, [result for result in results if result.object_name == name], options.tolerance))
    print(_row("all", results, options.tolerance))


def _line(result: Result) -> str:
    return (
        f"{result.object_name}, seed {result.seed}: {1000 * result.initial_error:.1f} mm off, "
        f"{1000 * result.error:.1f} mm after {result.scans} scans ({1000 * result.expected_error:.1f} mm expected), "
        f"{result.state}{'' if result.covered else ', the truth outside the 95 % region'}"
    )


def _row(name: str, results: Sequence[Result], tolerance: float) -> str:
    errors = 1000 * np.array([result.error for result in results])
    converged = [result for result in results if result.state is State.CONVERGED]
    cells = [
        name,
        str(len(results)),
        f"{1000 * np.mean([result.initial_error for result in results]):.1f}",
        f"{np.median(errors):.1f}, {errors.max():.1f}",
        f"{1000 * np.median([result.expected_error for result in results]):.1f}",
        f"{sum(result.covered for result in results)} of {len(results)}",
        str(len(converged)),
        str(sum(result.error <= tolerance for result in converged)),
        f"{np.mean([result.scans for result in results]):.1f}",
        f"{np.mean([result.seconds for result in results]):.0f}",
        str(sum(result.skipped for result in results)),
        str(sum(result.touches for result in results)),
    ]
    return "| " + " | ".join(cells) + " |"


if __name__ == "__main__":
    try:
        main()
    except PretouchError as error:
        raise SystemExit(f"{error.detail} {error.remedy}") from error
